"""Work that a scan will be: its size in cells, and how long a robot's cells take, measured as they go."""

import math
from collections import deque

from ogm_core.grid_settings import GridSettings
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.sensor_models.scan_size import ScanSize
from ogm_core.wire.keys import Source
from ogm_core.wire.messages import MAX_RANGE, glance

MESSAGE_CELLS = 30_000.0
"""What is done for any scan, whatever it says, takes as long as so many cells."""
BYTE_CELLS = 2.5
"""The same for each byte of it: to decode and to project a beam takes as long as ten cells."""
FIRST_RATE = 2e-9
"""How long a cell takes before any of a robot's was measured, s."""
SLOW_RATE = 50e-9
"""Cells that take longer than this, s each, tell of a moment in which the machine stood still."""
_BELIEVED = 4
"""Unless it happens to so many scans in a row."""
_NEWEST = 4
"""Scans that a rate is the mean of."""


class ScanSizes:
    """Sizes of scan messages, in cells.

    A size is read off the very ranges: whoever has sent small scans cannot pass off a large one as such. What
    cannot be read is as large as its bytes. Whoever calls it sees to it that only one thread does at a time.
    """

    def __init__(self, settings: GridSettings, sensors: SensorRules) -> None:
        self._size = ScanSize(settings)
        self._sensors = sensors

    def cells(self, source: Source, payload: bytes) -> float:
        """How many cells' time a scan message will take, about."""
        fixed = MESSAGE_CELLS + BYTE_CELLS * len(payload)
        seen = glance(payload)
        if seen is None:
            return fixed
        ranges, angle_increment, nearest, farthest = seen
        if not (0.0 <= nearest < farthest <= MAX_RANGE and math.isfinite(angle_increment)):
            return fixed  # the worker will not read it
        rule = self._sensors.rule_of(f"{source.robot}/{source.sensor}")
        if rule is None:
            return fixed + self._size.cells(ranges, angle_increment, nearest, farthest)
        nearest = nearest if rule.range_min is None else rule.range_min
        farthest = farthest if rule.range_max is None else rule.range_max
        return fixed + self._size.cells(
            *(ranges, angle_increment, nearest, farthest, rule.clear_range, rule.reach),
            beyond_clears=rule.beyond == "clear",
        )


class CellRate:
    """How long the cells of one robot's scans take, s each: the mean of the newest few scans.

    A robot whose scans take longer, or less long, than they look (new memory, refused at a glance) is known
    by it after one of them. That one or two took very long is not believed: four in a row are.
    """

    __slots__ = ("_newest", "_slow", "value")

    def __init__(self) -> None:
        self.value = FIRST_RATE
        self._newest: deque[tuple[float, float]] = deque(maxlen=_NEWEST)
        self._slow = 0

    def measured(self, cells: float, seconds: float) -> None:
        """Learn how long a scan took that was so large."""
        self._slow = self._slow + 1 if seconds > SLOW_RATE * cells else 0
        if 0 < self._slow < _BELIEVED:
            seconds = SLOW_RATE * cells
        self._newest.append((cells, seconds))
        all_cells = all_seconds = 0.0
        for some_cells, some_seconds in self._newest:
            all_cells += some_cells
            all_seconds += some_seconds
        self.value = all_seconds / all_cells
