"""Clock hints: sensors whose stamps are far from the time of a map that forgets (see cells.forgetting).

Each scan moves that time on to its own stamp, by a second at most, and never back: stamps that are ahead of
it age the map too fast, and by those that are behind it nothing is forgotten.
"""

from collections.abc import Callable
from dataclasses import dataclass

from ogm_core.types import Scan

FAR_IN_A_ROW = 10
BEHIND_IN_A_ROW = 50
"""So many scans are behind, and no less so in the end: those that come late catch up."""
FAR_BEHIND_NS = 3_600 * 10**9
"""So late comes none."""
FAR_AHEAD_NS = 7 * 86_400 * 10**9
"""Less than that a map's time may be behind that has rested meanwhile."""


@dataclass(slots=True)
class _Apart:
    """How many scans in a row were on one side of the map's time, and how far the first of them was, ns."""

    scans: int = 0
    first: int = 0


class ClockHints:
    """Compares the stamps of scans with the time of their map. One thread calls it."""

    def __init__(self, map_time: Callable[[], int | None], tick: int) -> None:
        """`map_time` is that of this moment, ns; `tick` how long one is, ns: what is nearer does no harm."""
        self._map_time = map_time
        self._tick = tick
        self._apart: dict[str, _Apart] = {}

    def placed(self, source: str, scan: Scan) -> str | None:
        """What there is to tell of a source after a scan that is in the map."""
        time = self._map_time()
        ahead = 0 if time is None else scan.stamp - time
        if -self._tick <= ahead <= FAR_AHEAD_NS:
            self._apart.pop(source, None)
            return None
        known = self._apart.get(source)
        if known is None or (known.first > 0) != (ahead > 0):
            known = self._apart[source] = _Apart(0, ahead)
        known.scans += 1
        if ahead > 0:
            return _AHEAD.format(ahead / 86_400e9) if known.scans >= FAR_IN_A_ROW else None
        far = ahead < -FAR_BEHIND_NS and known.scans >= FAR_IN_A_ROW
        if far or (known.scans >= BEHIND_IN_A_ROW and ahead <= known.first):
            return _BEHIND.format(-ahead / 1e9)
        if known.scans >= BEHIND_IN_A_ROW:
            known.scans, known.first = 0, ahead
        return None

    def forget(self, source: str) -> None:
        """Forget what was seen of a source."""
        self._apart.pop(source, None)


_AHEAD = (
    "its stamps are {:.3g} days ahead of the time of the map, which goes on by a second with each of its "
    "scans until it has come there, and so forgets too fast: set its clock, unless the map has rested for so "
    "long, or was begun by a clock that was wrong"
)
_BEHIND = (
    "its stamps are {:.3g} s behind the time of the map, with which the map forgets: its clock is behind, or "
    "that of a robot that came before was ahead: set the clocks of all robots"
)
