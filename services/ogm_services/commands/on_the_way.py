"""Scans of a replay that are on their way: no more than its share of what may wait at the mapper."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ogm_core.types import Scan
from ogm_core.units import MEBIBYTE
from ogm_core.wire.keys import Source

MAX_AHEAD = 64
"""Scans of one source that may be sent beyond the last that the mapper has taken."""
MAX_SCANS = 1024
"""The same of all sources: a quarter of what may wait there unless it was told another `mapper.queue`."""
MAX_BYTES = 32 * MEBIBYTE
"""An eighth of the bytes that may wait there."""
MAX_CELLS = 1e8
"""Cells that take a slow machine a second: a fifth of the work that may wait there."""


class Size(NamedTuple):
    """What one scan takes of the shares."""

    size: int
    """Bytes of its ranges."""
    cells: float


def size_of(scan: Scan, resolution: float) -> Size:
    """Size of a scan on a map of this resolution, m, whichever the map's sensor model is."""
    seen = np.where(np.isfinite(scan.ranges), np.clip(scan.ranges, 0.0, scan.range_max), scan.range_max)
    lengths = seen.astype(np.float64) / resolution
    area = abs(scan.angle_increment) / 2.0 * np.square(lengths).sum()
    return Size(scan.ranges.nbytes, float(lengths.sum() + area))


class _Sent(NamedTuple):
    run: str
    seq: int
    size: Size | None
    """None once it is known to wait no more, though the mapper has not told its seq: it is malformed."""


@dataclass
class OnTheWay:
    """Scans that were sent and that the mapper has not taken yet, as far as known."""

    sent: dict[Source, deque[_Sent]] = field(default_factory=dict)
    """By source, oldest first."""
    scans: int = 0
    size: int = 0
    cells: float = 0.0

    def add(self, source: Source, run: str, seq: int, size: Size) -> None:
        """Note a scan that is sent."""
        self.sent.setdefault(source, deque()).append(_Sent(run, seq, size))
        self._count([size], 1)

    def taken(self, source: Source, run: str, seq: int | None) -> None:
        """Forget everything of a source up to a scan that the mapper says it has taken."""
        ahead = self.sent.get(source, deque())
        if any((item.run, item.seq) == (run, seq) for item in ahead):
            gone = [ahead.popleft()]
            while (gone[-1].run, gone[-1].seq) != (run, seq):
                gone.append(ahead.popleft())
            self._count((item.size for item in gone), -1)

    def none_waits(self, source: Source) -> None:
        """Note that nothing of a source waits at the mapper: others may have its part of the share."""
        ahead = self.sent.get(source, deque())
        if ahead and ahead[-1].size is not None:
            self._count((item.size for item in ahead), -1)
            self.sent[source] = deque(item._replace(size=None) for item in ahead)

    def room_for(self, source: Source, size: Size, part: float = 1.0) -> bool:
        """Whether another scan fits into this part of the shares; one that is alone always does."""
        if len(self.sent.get(source, ())) >= part * MAX_AHEAD:
            return False
        return not self.scans or (
            self.scans < part * MAX_SCANS
            and self.size + size.size <= part * MAX_BYTES
            and self.cells + size.cells <= part * MAX_CELLS
        )

    def _count(self, sizes: Iterable[Size | None], sign: int) -> None:
        for size in filter(None, sizes):
            self.scans += sign
            self.size += sign * size.size
            self.cells += sign * size.cells
        if not self.scans:  # else what is lost in rounding would add up
            self.cells = 0.0
