"""Sums of counts: the planes of two maps of one lattice, added, as if one map had taken all of their beams.

Sums stop at the largest number that a plane can hold, of N and C together, so that their order never matters.
Halves of counts are what a map that forgets keeps of them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Planes

_ALONE = "F", "E", "H"
"""Planes that count by themselves; C counts the carries of N."""
_CARRY = np.uint32(16)
_LOW = np.uint32(0xFFFF)


def add_counts(sums: Mapping[str, NDArray[Any]], planes: Planes) -> None:
    """Add the planes of some cells (see cells.rate) to `sums`, those of as many cells, in place."""
    for name in _ALONE:
        _add(sums[name], planes[name])
    passing = _joined(sums)
    _add(passing, _joined(planes))
    sums["N"][...] = passing & _LOW
    sums["C"][...] = passing >> _CARRY


def halved_counts(planes: Planes, times: int) -> dict[str, NDArray[Any]]:
    """The planes of some cells, every count halved so many times; half a count is lost."""
    left: dict[str, NDArray[Any]] = {name: planes[name] >> times for name in _ALONE}
    passing = _joined(planes) >> np.uint32(times)
    return left | {
        "N": (passing & _LOW).astype(np.uint16),
        "C": (passing >> _CARRY).astype(np.uint16),
    }


def _joined(planes: Planes) -> NDArray[np.uint32]:
    """Length of passing of whole cells, N and C together, in 1/16 cell."""
    return planes["C"].astype(np.uint32) << _CARRY | planes["N"]


def _add(sums: NDArray[Any], numbers: NDArray[Any]) -> None:
    sums += numbers
    sums[sums < numbers] = np.iinfo(sums.dtype).max
