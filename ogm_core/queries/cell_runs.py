"""Runs of cells side by side, counted out cell by cell in pieces that bound the memory."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_PIECE = 2**18
"""Numbers that are worked on in one go, unless fewer are wanted."""

Ints = NDArray[np.int64]


def counted(first: Ints, last: Ints, piece: int | None = None) -> Iterator[tuple[Ints, Ints]]:
    """Every k with every whole number from first[k] to last[k], as two arrays, in pieces of so many."""
    piece = piece or _PIECE
    ends = np.cumsum(np.maximum(last - first + 1, 0), dtype=np.int64)
    total = int(ends[-1]) if ends.size else 0
    for start in range(0, total, piece):
        stop = min(start + piece, total)
        begin, end = np.searchsorted(ends, (start, stop - 1), side="right")
        reached = np.minimum(ends[begin : end + 1], stop)
        k = np.repeat(np.arange(begin, end + 1), reached - np.append(start, reached[:-1]))
        yield k, last[k] + 1 - ends[k] + np.arange(start, stop)
