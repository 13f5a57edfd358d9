"""Sensor rules: what is known of a sensor that its messages do not say, or say wrong."""

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from fnmatch import fnmatchcase
from typing import Any, Literal

import numpy as np

from ogm_core.errors import BadMessage
from ogm_core.types import Pose, Scan

ROUNDING = 1.0 + 1e-6
"""A float32 may be so much more than the `range_max` that it was rounded from."""
REMEMBERED_SOURCES = 1000
"""Sources whose rules are remembered; to look them up anew does no harm."""
MAX_TIME_OFFSET = 4e9
"""s; more than from the Unix epoch to our days, for a clock that was never set."""
_LAST_STAMP = 2**63 - 1

Beyond = Literal["skip", "clear"]
Deskew = Literal["auto", "off", "reversed"]


@dataclass(frozen=True, slots=True)
class SensorRule:
    """What holds for the scans of the sources that `match`, a glob on `<robot>/<sensor>`; None: as they say.

    `time_offset`: s, added to the stamp; at most 4e9 either way. `range_min`, `range_max`: m, in place of
    the scan's. `beyond`: a finite range above range_max is no reading ("skip"), or means that nothing was
    there ("clear").
    `clear_range`, `reach`: m, in place of the map's. `ignore_no_return`: beams without return say nothing.
    `deskew`: "off" takes the whole scan at its stamp; "auto" takes its beams by its time_increment;
    "reversed" likewise, but the last one first. `mount`: the sensor's pose in the base frame.
    `upside_down`: the bearings run the other way.
    """

    match: str
    time_offset: float | None = None
    range_min: float | None = None
    range_max: float | None = None
    beyond: Beyond | None = None
    clear_range: float | None = None
    reach: float | None = None
    ignore_no_return: bool | None = None
    deskew: Deskew | None = None
    mount: Pose | None = None
    upside_down: bool | None = None


_KEYS = tuple(field.name for field in fields(SensorRule) if field.name != "match")


class SensorRules:
    """Reads scans by the rules of their sources: for each key the first rule that matches and has it."""

    def __init__(self, rules: Iterable[SensorRule] = ()) -> None:
        self._rules = tuple(rules)
        self._of: dict[str, SensorRule | None] = {}
        self._matched: set[str] = set()

    @property
    def unmatched(self) -> list[str]:
        """The globs that no source has matched yet."""
        return [rule.match for rule in self._rules if rule.match not in self._matched]

    def read(self, source: str, scan: Scan) -> Scan:
        """A scan as the map is to read it: itself, where no rule changes it.

        Raises:
            BadMessage: what the rules say contradicts what the scan says.
        """
        rule = self.rule_of(source)
        return scan if rule is None else _read(scan, rule)

    def rule_of(self, source: str) -> SensorRule | None:
        """What holds for a source's scans, all rules together; None if no rule matches it."""
        if source in self._of:
            return self._of[source]
        if len(self._of) >= REMEMBERED_SOURCES:
            self._of.clear()
        found: dict[str, Any] = {}
        for rule in self._rules:
            if fnmatchcase(source, rule.match):
                self._matched.add(rule.match)
                given = {key: value for key in _KEYS if (value := getattr(rule, key)) is not None}
                found = given | found
        self._of[source] = SensorRule(source, **found) if found else None
        return self._of[source]


def _read(scan: Scan, rule: SensorRule) -> Scan:
    changed: dict[str, Any] = {
        key: value
        for key in ("range_min", "range_max", "clear_range", "reach", "mount")
        if (value := getattr(rule, key)) is not None
    }
    if rule.time_offset is not None:
        changed["stamp"] = scan.stamp + round(rule.time_offset * 1e9)
    if rule.deskew == "off":
        changed["time_increment"] = 0.0
    elif rule.deskew == "reversed" and scan.time_increment > 0.0:
        # Where time runs backwards already, as `ogm ros2` sends it, it is so.
        changed["time_increment"] = -scan.time_increment
        changed["stamp"] = changed.get("stamp", scan.stamp) + scan.end_stamp - scan.stamp
    if changed.get("stamp", 0) > _LAST_STAMP:
        raise BadMessage(f"stamp: by the settings of sensors past {_LAST_STAMP} ns")
    if rule.upside_down:
        changed |= {"angle_min": -scan.angle_min, "angle_increment": -scan.angle_increment}
    farthest = changed.get("range_max", scan.range_max)
    if rule.beyond == "clear" or rule.ignore_no_return:
        ranges = scan.ranges.copy()
        if rule.beyond == "clear":
            ranges[ranges > np.float64(farthest * ROUNDING)] = np.inf
        if rule.ignore_no_return:
            ranges[ranges >= np.float32(farthest)] = np.nan
        ranges.flags.writeable = False
        changed["ranges"] = ranges
    nearest = changed.get("range_min", scan.range_min)
    if not nearest < farthest:
        raise BadMessage(
            f"range_min: by the settings of sensors {nearest:g} m, not below range_max = {farthest:g} m"
        )
    return replace(scan, **changed)
