"""Hints at sensors whose data look wrong: nothing is decided by them, each is told once per source."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ogm_core.placing.clock_hints import ClockHints
from ogm_core.placing.sensor_rules import ROUNDING
from ogm_core.types import Pose, Scan

CLOSELY = 50
"""So many scans of a source are looked at one by one, later ones now and then."""
NOW_AND_THEN = 50
"""Every so many scans."""
ENOUGH = 10
"""Nothing is said of a source before so many scans were looked at."""
_SEVERAL_RANGES = 5
_BEYOND_SHARE = 0.05
_MOST = 0.5
_EMPTY_SHARE = 0.5
_AGREEING_SHARE = 0.1
_SLOW = 2.0
"""No 2D LiDAR takes longer for a scan, s."""
_WIDE = math.radians(5.0)
_FASTEST_NS = 1_000_000
"""No 2D LiDAR makes more than 1,000 scans a second, and few less than one: its stamps in us are nearer."""
_UNITS = (("s", 10**9), ("ms", 10**12), ("us", 10**15))
"""Stamps of our days, in these units, begin with these numbers, and end at 2.2 times them."""

Agreement = Callable[[Scan, Pose], tuple[int, int]]
"""Of some hits of a placed scan: how many end in cells with p > 0.5, and how many were judged."""


class Hint(NamedTuple):
    """What looks wrong: its name in the status, and what to do about it."""

    slug: str
    text: str


@dataclass(slots=True)
class _Seen:
    """What was seen of a source."""

    scans: int = 0
    told: set[str] = field(default_factory=set)
    range_max: float | None = None
    range_changes: int = 0
    looked_at: int = 0
    first_stamp: int = 0
    finite: int = 0
    beyond: int = 0
    beams: int = 0
    empty: int = 0
    usable: int = 0
    hits: int = 0
    agreeing: int = 0


class Hints:
    """Looks at scans as the map reads them. `agreement` asks the map; `sector`: it reads scans as sectors.

    `clocks` are those of a map that forgets.
    """

    def __init__(
        self, agreement: Agreement | None = None, *, sector: bool = False, clocks: ClockHints | None = None
    ) -> None:
        self._agreement = agreement
        self._clocks = clocks
        self._sector = sector
        self._sources: dict[str, _Seen] = {}

    def look(self, source: str, scan: Scan) -> Sequence[Hint]:
        """Look at a scan as it comes: what there is to tell, each hint at most once for every source."""
        seen = self._sources.get(source)
        if seen is None:
            seen = self._sources[source] = _Seen(first_stamp=scan.stamp)
        seen.scans += 1
        if seen.scans > CLOSELY and seen.scans % NOW_AND_THEN:
            return ()
        seen.looked_at += 1
        seen.range_changes += seen.range_max is not None and scan.range_max != seen.range_max
        seen.range_max = scan.range_max
        ranges = scan.ranges
        beyond = (ranges > np.float64(scan.range_max * ROUNDING)) & (ranges < math.inf)
        beyonds = int(np.count_nonzero(beyond))
        seen.finite += int(np.count_nonzero(np.isfinite(ranges)))
        seen.beyond += beyonds
        seen.beams += ranges.size
        seen.empty += int(np.count_nonzero(ranges >= np.float32(scan.range_max))) - beyonds
        seen.usable += int(np.count_nonzero((ranges > 0.0) & (ranges >= scan.range_min) & ~beyond))
        found = [hint for hint in self._found(seen, scan) if hint.slug not in seen.told]
        seen.told.update(hint.slug for hint in found)
        return found

    def forget(self, source: str) -> None:
        """Forget what was seen of a source."""
        self._sources.pop(source, None)
        if self._clocks is not None:
            self._clocks.forget(source)

    def placed(self, source: str, scan: Scan, pose: Pose) -> Sequence[Hint]:
        """Look at a scan that is in the map: how far its stamp is from the map's time, and what is below."""
        hints = self._agreeing(source, scan, pose)
        seen = self._sources.get(source)
        if self._clocks is None or seen is None or "map_clock" in seen.told:
            return hints
        clock = self._clocks.placed(source, scan)
        if clock is None:
            return hints
        seen.told.add("map_clock")
        return (*hints, Hint("map_clock", clock))

    def _agreeing(self, source: str, scan: Scan, pose: Pose) -> Sequence[Hint]:
        """Ask the map about a scan that is in it, if most of its source's beams have no return; likewise."""
        if self._agreement is None:
            return ()
        seen = self._sources.get(source)
        if seen is None or seen.scans % NOW_AND_THEN or "ignore_no_return" in seen.told:
            return ()
        if seen.looked_at < ENOUGH or seen.empty <= _EMPTY_SHARE * seen.beams:
            return ()
        agreeing, hits = self._agreement(scan, pose)
        seen.agreeing += agreeing
        seen.hits += hits
        if seen.hits < ENOUGH or seen.agreeing >= _AGREEING_SHARE * seen.hits:
            return ()
        seen.told.add("ignore_no_return")
        return (Hint("ignore_no_return", _NO_RETURN.format(seen.empty / seen.beams)),)

    def _found(self, seen: _Seen, scan: Scan) -> list[Hint]:
        found = []
        turns = (scan.ranges.size - 2) * abs(scan.angle_increment) / math.tau
        if turns > 1.0:
            found.append(Hint("turns", _TURNS.format(turns)))
        swept = (scan.ranges.size - 1) * abs(scan.time_increment)
        if swept > _SLOW:
            found.append(Hint("time_increment", _SWEPT.format(swept)))
        if self._sector and scan.ranges.size > 1 and abs(scan.angle_increment) > _WIDE:
            found.append(Hint("sector", _SECTOR.format(math.degrees(abs(scan.angle_increment)))))
        if seen.range_changes >= _SEVERAL_RANGES:
            found.append(Hint("range_max", _RANGE_MAX))
        if seen.looked_at >= ENOUGH and seen.beyond > _BEYOND_SHARE * seen.finite:
            share = seen.beyond / seen.finite
            cure = _METRES if share > _MOST else _CLEAR
            found.append(Hint("beyond", _BEYOND.format(share, scan.range_max) + cure))
        if seen.looked_at >= CLOSELY and not seen.usable:
            found.append(Hint("nothing_counts", _NOTHING_COUNTS.format(scan.range_min, scan.range_max)))
        if seen.looked_at >= CLOSELY and seen.usable == seen.empty > 0:
            found.append(Hint("ignore_no_return", _NO_HIT))
        if seen.scans == ENOUGH:
            spacing = abs(scan.stamp - seen.first_stamp) / (ENOUGH - 1)
            unit = next((unit for unit, least in _UNITS if least <= scan.stamp <= 2.2 * least), None)
            if unit is not None and spacing < _FASTEST_NS:
                found.append(Hint("stamp", _STAMP.format(unit)))
        return found


_NO_RETURN = (
    "{:.0%} of its beams have no return, and where the others end the map has no wall: if it says inf for an "
    "invalid reading, set ignore_no_return for it"
)
_NO_HIT = (
    "not one of its beams has ever had a return: if it says inf for an invalid reading, set ignore_no_return "
    "for it"
)
_NOTHING_COUNTS = (
    "not one of its beams has ever counted: all are NaN, below its range_min of {:g} m or above its "
    "range_max of {:g} m"
)
_SWEPT = (
    "by its time_increment a scan takes {:.3g} s: is that in seconds? deskew: off takes each scan at its "
    "stamp"
)
_TURNS = "its bearings go {:.3g} times round: are they degrees? Radians are needed"
_SECTOR = (
    "its bearings are {:.3g} degrees apart, and the sensor model sector fills what lies between: use beam"
)
_RANGE_MAX = (
    "its range_max differs from scan to scan, and readings near range_max count as no return, so walls are "
    "erased: set range_max for it to what the sensor can reach"
)
_BEYOND = "{:.0%} of its finite ranges are above its range_max of {:g} m, and are skipped: "
_METRES = "are they in metres, and is range_max what the sensor can reach?"
_CLEAR = "if they mean that nothing was there, set beyond to clear for it"
_STAMP = "its stamps look like {} since 1970: ns are needed"
