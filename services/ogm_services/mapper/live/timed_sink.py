"""Map on the way in that measures how long it takes for each scan."""

import time
from dataclasses import dataclass

from prometheus_client import Histogram

from ogm_core.placing.scan_placer import ScanSink
from ogm_core.types import Pose, Scan, Sweep


@dataclass(frozen=True)
class TimedSink:
    """A map that measures how long it takes for each scan that it integrates."""

    sink: ScanSink
    histogram: Histogram

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Hand a scan on to the map; see `ScanSink`."""
        began = time.perf_counter()
        updates = self.sink.integrate(scan, pose, sweep)
        self.histogram.observe(time.perf_counter() - began)
        return updates
