"""Feed of a log: its messages, in file order, through the scan placer that live messages go through."""

from typing import Protocol

from ogm_core.errors import BadMessage
from ogm_core.logs.recorded import RecordedScan
from ogm_core.placing.hints import Hints
from ogm_core.placing.other_robots import OtherRobots
from ogm_core.placing.placement import ScanSink
from ogm_core.placing.reasons import too_many_robots, too_many_sensors
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.robot_rules import RobotRules
from ogm_core.placing.scan_placer import ROBOTS, ScanPlacer
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.types import Scan
from ogm_services.commands.held_scans import ALL_MAPPED, HeldScans
from ogm_services.commands.log_readers import LogReader
from ogm_services.runtime.complaints import Complaints
from ogm_services.runtime.progress import progress_bar
from ogm_services.settings.settings import Settings


class LogSink(ScanSink, Protocol):
    """Where the scans of a log go."""

    withheld: set[Scan]
    """Those that stay out of the map."""
    robot: str
    """Whose message is being read."""


class LogFeed:
    """One pass over a log, and what was counted and complained of in it.

    `held` says which scans are withheld, and which are passed over.
    """

    def __init__(self, settings: Settings, held: HeldScans = ALL_MAPPED) -> None:
        self.receipts = Receipts()
        self.complaints = Complaints()
        self.sensors = SensorRules(settings.sensor_rules())
        self.robots = RobotRules(settings.robot_rules())
        self._mark_hits = hits_at_robots(settings.grid_settings())
        self._rules = settings.placing_rules()
        self._held = held

    def run(self, messages: LogReader, sink: LogSink, text: str, hints: Hints | None = None) -> None:
        """Send every message to `sink`, up to and including what waits for poses; `text` names the pass."""

        def replaced(scan: Scan, without_robots: Scan) -> None:
            if scan in sink.withheld:
                sink.withheld.remove(scan)
                sink.withheld.add(without_robots)

        others = OtherRobots(self.robots, self._mark_hits, replaced)
        placer = ScanPlacer(sink, self.receipts, self.complaints.add, self._rules, hints, other_robots=others)
        index = 0
        with progress_bar(text, messages.size) as show:
            for message in messages:
                # A message makes scans of its own robot ready, and of no other.
                sink.robot = message.robot
                if isinstance(message, RecordedScan):
                    if self._held.counts(index):
                        self._take_scan(placer, sink, message, held_out=self._held.holds(index))
                    index += 1
                    show(messages.position)
                else:
                    if self.receipts.pose_received(message.robot):
                        placer.add_pose(message.robot, message.message)
                    else:
                        self.complaints.add(ROBOTS, *too_many_robots(message.robot))
        placer.finish()

    def _take_scan(self, placer: ScanPlacer, sink: LogSink, message: RecordedScan, *, held_out: bool) -> None:
        robot, sensor = message.robot, message.sensor
        if not self.receipts.scan_received(robot, sensor):
            known = self.receipts.admits(robot)
            why = too_many_sensors(sensor) if known else too_many_robots(robot)
            self.complaints.add(robot if known else ROBOTS, *why)
            return
        try:
            scan = self.sensors.read(f"{robot}/{sensor}", message.message)
        except BadMessage as error:
            self.receipts.scan_dropped(robot, sensor, "malformed")
            self.complaints.add(f"{robot}/{sensor}", "malformed", str(error))
            return
        if held_out:
            sink.withheld.add(scan)
        placer.add_scan(robot, sensor, scan)
