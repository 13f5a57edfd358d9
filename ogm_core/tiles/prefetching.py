"""Fetching cells ahead: a processor is told which memory will be written soon, and has it near by then."""

from collections.abc import Callable
from typing import Any, cast

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

_TO_WRITE, _SOON, _DATA = 1, 3, 1
"""What `llvm.prefetch` is told."""


def fetch_ahead(cells: Any, address: Any) -> None:  # noqa: ANN401 - an array, and a place in it
    """Have a cell near before it is changed. It changes nothing."""


@intrinsic
def _prefetched(_: Any, cells: Any, address: Any) -> Any:  # noqa: ANN401 - numba's types
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        place = builder.bitcast(builder.gep(array.data, [arguments[1]]), cgutils.voidptr_t)
        number = ir.IntType(32)
        form = ir.FunctionType(ir.VoidType(), (cgutils.voidptr_t, number, number, number))
        function = cgutils.get_or_insert_function(builder.module, form, "llvm.prefetch.p0i8")  # type: ignore[no-untyped-call]
        builder.call(function, [place, *(ir.Constant(number, how) for how in (_TO_WRITE, _SOON, _DATA))])
        return context.get_dummy_value()

    return types.void(cells, address), generate


_prefetch = cast(Callable[[Any, Any], None], _prefetched)


@overload(fetch_ahead)
def _fetch_ahead(cells: Any, address: Any) -> Any:  # noqa: ANN401 - numba types
    def fetch(cells: Any, address: Any) -> None:  # noqa: ANN401
        _prefetch(cells, address)

    return fetch
