"""Cell updates: what kernels do to one stored number of a plane when a beam `passed` its cell, or `ended`.

numba picks the model's arithmetic by the dtype of the plane; plain Python, by the number's class. Kernels
hand `constants` on without looking: float64 cells have none for a prior that is 0. A beam's `length` in the
cell and the `weight` of a hit are there for models that want them; where they are ignored they cost nothing.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from ogm_core.cells.saturating import lowered

_EVEN = 4
"""So many constants float64 cells have whose prior is 0."""


def _passed_int16(cell: Any, length: Any, constants: Any) -> Any:  # noqa: ANN401 - one form a dtype
    # Log odds. No known bit: a cell that was never updated becomes negative, till a hit sets the bit.
    free, _, lower, _, _ = constants
    return max(cell, lower - free) + free


def _passed_int16_compiled(cell: Any, length: Any, constants: Any) -> Any:  # noqa: ANN401
    # The same number; all increments of int16 cells are even (see log_odds.CellConstants).
    free, _, lower, _, _ = constants
    return lowered(cell, np.int16(free >> 1), np.int16(lower))


def _ended_int16(cell: Any, weight: Any, constants: Any) -> Any:  # noqa: ANN401
    _, occupied, _, upper, _ = constants
    return (min(cell, upper - occupied) + occupied) | 1


def _passed_float64(cell: Any, length: Any, constants: Any) -> Any:  # noqa: ANN401
    free, _, lower, _, prior = constants
    if cell < 0.0:  # most cells: known, and an increment makes no zero of them
        return max(cell + free, lower)
    if cell == 0.0 and math.copysign(1.0, cell) > 0.0:
        cell = prior
    cell = max(cell + free, lower)
    return -0.0 if cell == 0.0 else cell


def _ended_float64(cell: Any, weight: Any, constants: Any) -> Any:  # noqa: ANN401
    _, occupied, _, upper, prior = constants
    if cell == 0.0 and math.copysign(1.0, cell) > 0.0:
        cell = prior
    cell = min(cell + occupied, upper)
    return -0.0 if cell == 0.0 else cell


def _passed_even_float64(cell: Any, length: Any, constants: Any) -> Any:  # noqa: ANN401
    # A cell that was never updated holds the prior, 0.0: nobody asks. Kernels take two thirds of the time.
    free, _, lower, _ = constants
    cell = max(cell + free, lower)
    return -0.0 if cell == 0.0 else cell


def _ended_even_float64(cell: Any, weight: Any, constants: Any) -> Any:  # noqa: ANN401
    _, occupied, _, upper = constants
    cell = min(cell + occupied, upper)
    return -0.0 if cell == 0.0 else cell


def passed(cell: Any, length: Any, constants: Any) -> Any:  # noqa: ANN401
    """Stored number after a beam went through: of log odds, l <- max(l + d_free, l_min), and known."""
    if isinstance(cell, np.floating):
        return (_passed_float64 if len(constants) > _EVEN else _passed_even_float64)(cell, length, constants)
    return _passed_int16(int(cell), length, constants)


def ended(cell: Any, weight: Any, constants: Any) -> Any:  # noqa: ANN401
    """Stored number after a beam's hit in its cell: of log odds, l <- min(l + d_occ, l_max), and known."""
    if isinstance(cell, np.floating):
        return (_ended_float64 if len(constants) > _EVEN else _ended_even_float64)(cell, weight, constants)
    return _ended_int16(int(cell), weight, constants)


@overload(passed)
def _passed(cell: Any, length: Any, constants: Any) -> Any:  # noqa: ANN401 - numba types
    if not isinstance(cell, types.Float):
        return _passed_int16_compiled
    return _passed_float64 if len(constants) > _EVEN else _passed_even_float64


@overload(ended)
def _ended(cell: Any, weight: Any, constants: Any) -> Any:  # noqa: ANN401 - numba types
    if not isinstance(cell, types.Float):
        return _ended_int16
    return _ended_float64 if len(constants) > _EVEN else _ended_even_float64
