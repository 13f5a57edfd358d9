"""Arithmetic of single int16 cells in the processor's vector unit, for kernels that change them one by one.

Comparing, choosing and adding take a scalar unit more instructions than all else about a cell; a vector unit
takes one each, in units that are idle meanwhile. Kernels along beams take a third less time.
"""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_LANES = 8
"""Numbers of the smallest vector that every processor has."""
_VECTOR = ir.VectorType(ir.IntType(16), _LANES)
_FIRST = ir.Constant(ir.IntType(32), 0)
_ALL_FIRST = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
_ANY = ir.Constant(_VECTOR, ir.Undefined)


@intrinsic
def _lowered(_: Any, cell: Any, half: Any, least: Any) -> Any:  # noqa: ANN401 - numba's types
    """`lowered`, as numba wants it."""
    number = types.int16

    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:  # noqa: ANN401
        value, step, lowest = (builder.insert_element(_ANY, number, _FIRST) for number in arguments)
        step, lowest = (builder.shuffle_vector(number, _ANY, _ALL_FIRST) for number in (step, lowest))
        for name, operand in (("sadd.sat", step), ("sadd.sat", step), ("smax", lowest)):
            form = ir.FunctionType(_VECTOR, (_VECTOR, _VECTOR))
            full = f"llvm.{name}.v{_LANES}i16"
            function = cgutils.get_or_insert_function(builder.module, form, full)  # type: ignore[no-untyped-call]
            value = builder.call(function, (value, operand))
        return builder.extract_element(value, _FIRST)

    return number(number, number, number), generate


lowered = cast(Callable[[Any, Any, Any], Any], _lowered)
"""max(cell + 2 half, least), exactly, of int16 numbers with half <= 0: for kernels.

Half a step fits int16 when a whole one may not, and a sum that saturates is below any `least`.
"""
