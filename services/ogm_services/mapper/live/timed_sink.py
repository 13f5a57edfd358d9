"""Map on the way in that measures how long it takes for each scan."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from ogm_core.placing.placement import ScanSink
from ogm_core.types import Pose, Scan, Sweep


@dataclass(frozen=True)
class TimedSink:
    """A map that measures how long it takes for each scan that it integrates."""

    sink: ScanSink
    took: Callable[[float], None]
    """Told of each, s."""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Hand a scan on to the map; see `ScanSink`."""
        began = time.perf_counter()
        updates = self.sink.integrate(scan, pose, sweep)
        self.took(time.perf_counter() - began)
        return updates
