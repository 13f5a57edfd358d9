"""What the kernels do to one stored cell, for either storage form (see log_odds).

numba picks the form by the type of the cell; plain Python, by its class.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import overload

from ogm_core.cells.log_odds import CellConstants


def _free_int16(cell: Any, constants: Any) -> Any:  # noqa: ANN401 - one form a storage type
    # No known bit: a cell that was never updated becomes negative, and stays so till a hit sets the bit.
    return max(cell, constants.lower - constants.free) + constants.free


def _occupied_int16(cell: Any, constants: Any) -> Any:  # noqa: ANN401
    return (min(cell, constants.upper - constants.occupied) + constants.occupied) | 1


def _free_float64(cell: Any, constants: Any) -> Any:  # noqa: ANN401
    if cell < 0.0:  # most cells: known, and an increment makes no zero of them
        return max(cell + constants.free, constants.lower)
    if cell == 0.0 and math.copysign(1.0, cell) > 0.0:
        cell = constants.prior
    cell = max(cell + constants.free, constants.lower)
    return -0.0 if cell == 0.0 else cell


def _occupied_float64(cell: Any, constants: Any) -> Any:  # noqa: ANN401
    if cell == 0.0 and math.copysign(1.0, cell) > 0.0:
        cell = constants.prior
    cell = min(cell + constants.occupied, constants.upper)
    return -0.0 if cell == 0.0 else cell


def add_free(cell: Any, constants: CellConstants) -> Any:  # noqa: ANN401
    """Stored cell after one observation "free": l <- max(l + d_free, l_min), and known (log_odds)."""
    return (
        _free_float64(cell, constants) if isinstance(cell, np.floating) else _free_int16(int(cell), constants)
    )


def add_occupied(cell: Any, constants: CellConstants) -> Any:  # noqa: ANN401
    """Stored cell after one observation "occupied": l <- min(l + d_occ, l_max), and known."""
    if isinstance(cell, np.floating):
        return _occupied_float64(cell, constants)
    return _occupied_int16(int(cell), constants)


@overload(add_free)
def _add_free(cell: Any, constants: Any) -> Any:  # noqa: ANN401 - numba types
    return _free_float64 if isinstance(cell, types.Float) else _free_int16


@overload(add_occupied)
def _add_occupied(cell: Any, constants: Any) -> Any:  # noqa: ANN401 - numba types
    return _occupied_float64 if isinstance(cell, types.Float) else _occupied_int16
