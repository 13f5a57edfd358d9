"""Map on the way in that measures how long it takes for each scan."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from ogm_core.tiles.checkpoint import NOBODY
from ogm_core.types import Pose, Scan, Sweep
from ogm_services.mapper.live.live_map import LiveMap


@dataclass(frozen=True)
class TimedSink:
    """A map that measures how long it takes for each scan that it integrates."""

    sink: LiveMap
    took: Callable[[float], None]
    """Told of each, s."""
    robot: str = NOBODY
    """Whose scans they are."""

    def of(self, robot: str) -> "TimedSink":
        """The same for the scans of a robot."""
        return TimedSink(self.sink, self.took, robot)

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Hand a scan on to the map; see `ScanSink`."""
        began = time.perf_counter()
        updates = self.sink.integrate(scan, pose, sweep, self.robot)
        self.took(time.perf_counter() - began)
        return updates
