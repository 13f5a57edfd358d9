"""Recent scans: the newest that are in the map, by which the live consistency is judged."""

from collections import deque
from collections.abc import Iterator

from ogm_core.types import PlacedScan
from ogm_core.units import MEBIBYTE

RECENT_SCANS = 100
"""The live consistency is that of so many newest scans."""
RECENT_BYTES = 64 * MEBIBYTE
"""What they hold at most: of very long scans there are fewer."""


class RecentScans:
    """The newest scans that are in the map, as far as they take no more than their share, bytes; 0: none."""

    def __init__(self, share: int) -> None:
        self.share = share
        self.nbytes = 0
        self._scans: deque[PlacedScan] = deque()

    def __iter__(self) -> Iterator[PlacedScan]:
        return iter(self._scans)

    def __len__(self) -> int:
        return len(self._scans)

    def append(self, placed: PlacedScan) -> None:
        """Add the newest, and let go of the oldest that are too many or too large."""
        self._scans.append(placed)
        self.nbytes += _bytes_of(placed)
        while len(self._scans) > RECENT_SCANS or self.nbytes > self.share:
            self.nbytes -= _bytes_of(self._scans.popleft())

    def clear(self) -> None:
        """Let go of all."""
        self._scans.clear()
        self.nbytes = 0


def _bytes_of(placed: PlacedScan) -> int:
    sweep = placed.sweep
    return placed.scan.nbytes + (0 if sweep is None else sweep.beams.nbytes)
