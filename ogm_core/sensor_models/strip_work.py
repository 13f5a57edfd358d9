"""Strip work: how many cells of a scan lie in which columns, about, and where to cut them evenly.

Columns are counted from the left side of a `window`, the contents of a CellRect, and are put together `wide`
by `wide`: shape (n,), float64. One beam or span in a few is looked at: the rest is like it.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.sensor_models.beams import IX, IX0, IY, IY0, KIND, SKIPPED, Plain

Work = NDArray[np.float64]
_ONE_IN = 8


@njit(cache=True, error_model="numpy", forceinline=True)
def _spread(cells: float, first: int, last: int, wide: int, work: Work, rise: Work) -> None:
    """Spread cells evenly over the columns from `first` to `last`, and count those inside.

    `rise`, shape (n,), is by how much more each place gets than the one before, beside what is in `work`.
    """
    each = _ONE_IN * cells / (last - first + 1)
    first, last = max(first, 0), min(last, wide * work.size - 1)
    if first > last:
        return
    left, right = first // wide, last // wide
    work[left] += each * (min(last, wide * left + wide - 1) - first + 1)
    if right > left:
        work[right] += each * (last - wide * right + 1)
        rise[left + 1] += each * wide
        rise[right] -= each * wide


@njit(cache=True, error_model="numpy", forceinline=True)
def _add_up(rise: Work, work: Work) -> None:
    level = 0.0
    for place in range(work.size):
        level += rise[place]
        work[place] += level


@njit(cache=True, error_model="numpy")
def work_of_beams(ends: NDArray[np.int64], bits: int, window: Plain, wide: int, work: Work) -> None:
    """Add the cells along the beams in `ends` (projection.Beams), which count in 2^-bits cells, to `work`."""
    window, rise = CellRect(*window), np.zeros(work.size)
    for b in range(0, ends.shape[1], _ONE_IN):
        if ends[KIND, b] == SKIPPED:
            continue
        i0, i1 = (ends[IX0, b] >> bits) - window.ix, (ends[IX, b] >> bits) - window.ix
        rows = abs(ends[IY, b] - ends[IY0, b]) >> bits
        _spread(float(max(abs(i1 - i0), rows)), min(i0, i1), max(i0, i1), wide, work, rise)
    _add_up(rise, work)


@njit(cache=True, error_model="numpy")
def work_of_spans(spans: NDArray[np.int32], window: Plain, wide: int, work: Work) -> None:
    """Add the cells of the spans (sensor_models.spans) to `work`."""
    window, rise = CellRect(*window), np.zeros(work.size)
    for n in range(0, spans.shape[0], _ONE_IN):
        first, end = spans[n, 1] - window.ix, spans[n, 2] - window.ix
        if 0 <= spans[n, 0] - window.iy < window.height:
            _spread(float(end - first), first, end - 1, wide, work, rise)
    _add_up(rise, work)


@njit(cache=True, error_model="numpy")
def even_cuts(work: Work, most: int, least: float, ahead: float) -> NDArray[np.int64]:
    """Where to cut into up to `most` parts of even work, each of at least about half of `least`.

    Returns at which places in `work` parts begin, and its size: two numbers are one part. The first part
    gets `ahead` more than the others, whose threads begin later.
    """
    total = work.sum()
    parts = max(1, min(most, int(total / least)))
    cuts = np.zeros(parts + 1, np.int64)
    count, done, begun = 1, 0.0, 0.0
    wanted = (total - ahead) / parts + ahead
    for place in range(work.size):
        # Before this place or behind it: whichever is nearer to what was wanted.
        if count < parts and done + work[place] / 2.0 > wanted and done - begun >= least / 2.0:
            cuts[count] = place
            count += 1
            begun = done
            wanted = done + (total - done) / (parts - count + 1)
        done += work[place]
    if count > 1 and total - begun < least / 2.0:
        count -= 1
    cuts[count] = work.size
    return cuts[: count + 1]
