"""Predicted hits: whether the map, as it was before, knows where the beams of its newest scans end.

Scans are judged by the newest copy of the map that does not have them yet: nothing need be held out.
"""

from ogm_core.quality.first_walls import count_hits
from ogm_services.mapper.live.served_map import WatchedMap

EVERY = 10
"""One scan in so many is judged."""
MOST_SCANS = 10
"""So many at a time, at most."""
MOST_BEAMS = 128
"""Of a scan so many beams, at most, evenly spread."""


class PredictedHits:
    """Judges scans of a live map, one in ten. One thread's; the writer is not asked to wait."""

    def __init__(self, live_map: WatchedMap) -> None:
        self._map = live_map
        self._epoch = ""
        self._scans = 0
        """How many were in the map when it was last looked at."""
        self._owed = 0
        """How many came since scans were last judged."""

    def share(self) -> float | None:
        """Share of returns below 15 m that were hits (see `FirstWalls`), of scans that came since last time.

        None if none was judged: few came, or the newest copy of the map has them all.
        """
        ahead = self._map.ahead_of_copy()
        if ahead is None:
            return None
        if ahead.copy.epoch != self._epoch:
            self._epoch, self._scans, self._owed = ahead.copy.epoch, ahead.copy.scans, 0
        self._owed = min(self._owed + ahead.scans - self._scans, MOST_SCANS * EVERY)
        self._scans = ahead.scans
        wanted = min(self._owed // EVERY, len(ahead.newest))
        if not wanted:
            return None
        self._owed -= wanted * EVERY
        chosen = ahead.newest[:: -(len(ahead.newest) // wanted)][:wanted]
        counts = [count_hits(ahead.copy, placed, ahead.settings, MOST_BEAMS) for placed in chosen]
        judged = sum(beams for _, beams in counts)
        return sum(hits for hits, _ in counts) / judged if judged else None
