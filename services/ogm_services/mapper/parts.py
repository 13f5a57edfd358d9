"""Parts of a mapper: everything that it is made of before it is on the network, and how they are joined.

A scan's way: `ZenohSubscriber` (the service adds it), `queue`, `worker`, `placer`, `live_map`, `answers`.
Each part is given the next one on that way, so they are made from the map outwards.
"""

import logging
import threading
import uuid
from collections.abc import Callable
from functools import partial

from ogm_core.grid_settings import GridSettings
from ogm_core.placing.other_robots import OtherRobots
from ogm_core.placing.receipts import Receipts, Whose
from ogm_core.placing.robot_rules import RobotRules
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.placing.waiting import WaitingLimits
from ogm_core.quality.figures import hints_by
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.sensor_models.scan_size import ScanSize
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.shares import Ground
from ogm_core.types import PlacedScan
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.handing_on import skipping
from ogm_services.mapper.intake.in_step import InStep
from ogm_services.mapper.intake.overload import Overload
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.work import ScanSizes
from ogm_services.mapper.intake.worker import Worker
from ogm_services.mapper.limits import Limits
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.load import FallingBehind
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.live.newest_scans import NewestScans
from ogm_services.mapper.live.presence import RobotPresence
from ogm_services.mapper.live.start_map import started_grid
from ogm_services.mapper.live.timed_sink import TimedSink
from ogm_services.mapper.live.watch import Watch
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.live_updates import LiveUpdates
from ogm_services.mapper.serving.load_metrics import (
    memory_metrics,
    queue_metrics,
    ready_metric,
    store_metrics,
)
from ogm_services.mapper.serving.metrics import Metrics
from ogm_services.mapper.serving.saved_maps import SavedMaps
from ogm_services.mapper.serving.writes import Writes
from ogm_services.mapper.storage.kept_map import KeptMap
from ogm_services.replies.in_flight import InFlight
from ogm_services.runtime.limited_log import LimitedLog
from ogm_services.runtime.memory import MemoryUse
from ogm_services.settings.settings import Settings

log = logging.getLogger(__name__)


class Parts:
    """Made in the order of the methods below; each attribute says which thread it belongs to.

    No thread runs yet but the store's: the service starts them, and closes them in the opposite order.
    """

    def __init__(self, settings: Settings) -> None:
        self.ready = threading.Event()
        """Set by the service: it has got as far as taking scans."""
        self.stopping = threading.Event()
        """Set by the service: it has begun to stop."""
        self.memory = MemoryUse(settings.mapper.max_memory)
        """What all parts hold together; any thread."""
        self.limits = Limits.of(settings.mapper, self.memory)
        self.share = settings.shares.of_mapper()
        """Which part of a map that is cut it keeps; None: all of it."""
        self.receipts = Receipts(in_shares=self.share is not None)
        """What became of every message; any thread."""
        count = settings.mapper.thread_count
        self.threads = UpdateThreads(count) if count > 1 else None
        """What updates the cells of large scans; the worker's."""
        data = settings.mapper.data
        self.kept_map = None if data is None else KeptMap(data)
        """The map on disk; a thread."""
        try:
            self._make_map(settings)
            self._make_intake(settings)
            self._make_watch()
            self._make_answers(settings)
        except BaseException:
            self.close()
            raise

    def stop_mapping(self, timeout: float) -> None:
        """Finish the scan in hand, for `timeout` s at most, and then begin to store the last map."""
        self.worker.stop(timeout)
        if self.kept_map is not None and not self.worker.alive:
            self.kept_map.finish()

    def close(self) -> None:
        """Close what is open before the service starts; once the worker runs no more. Once is enough."""
        if self.threads is not None:
            self.threads.close()
        if self.kept_map is not None:
            self.kept_map.close()

    def _make_map(self, settings: Settings) -> None:
        """The map, as it is when the mapper starts."""
        self.run = uuid.uuid4().hex
        """Of this process: its liveliness token has it, and every map."""
        grid = None
        if self.kept_map is not None:
            made_of = settings.mapper_grid_settings()
            grid = self.kept_map.restored(made_of, self.run, settings.mapper.start_map)
        self.restored = grid is not None
        """Whether the map was in the store."""
        if grid is None:
            grid = started_grid(settings, uuid.uuid4().hex, self.run)
        self.grid_settings: GridSettings = grid.settings
        self.live_map = LiveMap(grid, self.memory, self.threads)
        """The worker writes it, any thread reads it."""

    def _make_intake(self, settings: Settings) -> None:
        """What a message passes on its way into the map."""
        limits, grid_settings = self.limits, self.grid_settings
        sizes = ScanSizes(grid_settings, SensorRules(settings.sensor_rules()))
        self.queue = queue = ScanQueue(
            *(limits.queue_scans, sizes.cells, limits.queue_bytes),
            dropping=lambda *message: overloaded(*message),
        )
        """Zenoh's threads put, the worker takes."""
        self.metrics = self._metrics()
        """Any thread."""
        self.newest_scans = NewestScans(lambda: self.live_map.now.epoch)
        """The worker notes them, any thread reads."""
        robot_rules = RobotRules(settings.robot_rules())
        self.placer = placer = self._placer(settings, robot_rules)
        """The worker's; what it has decided, any thread asks."""
        overloaded = skipping(placer.decided, "overload")
        self.memory.add("queue", lambda: queue.bytes, limits.queue_bytes)
        self.memory.add("waiting", lambda: placer.waiting_bytes, limits.waiting_bytes)
        self.memory.add("robots", lambda: placer.robots_bytes, limits.robots_bytes)
        self.overload = Overload(queue, self.receipts)
        """Any thread."""
        kept = self.kept_map
        if kept is not None:
            kept.go_on(self.live_map, grid_settings, self.run, placer)
        self.in_step = InStep(placer.recent_robots()) if robot_rules else None
        """Any thread; None where the order between robots does not matter."""
        self.worker = self._worker(settings, malformed=skipping(placer.decided, "malformed"))
        """A thread, which alone writes the map."""

    def _placer(self, settings: Settings, robot_rules: RobotRules) -> ScanPlacer:
        """What decides which scans come into the map, and from where they looked."""
        limits, grid_settings, measured = self.limits, self.grid_settings, self.metrics.measurements
        sink = TimedSink(self.live_map, measured.integration.observe)
        return ScanPlacer(
            *(sink, self.receipts, LimitedLog(log).of_kind, settings.placing_rules()),
            hints=hints_by(self.live_map.snapshot, grid_settings, lambda: self.live_map.time),
            integrated=measured.scan_integrated,
            limits=WaitingLimits(limits.waiting_bytes, limits.waiting_cells, ScanSize(grid_settings).at_most),
            stopping=lambda: self.queue.closed,
            robots_limit=limits.robots_bytes,
            other_robots=OtherRobots(robot_rules, hits_at_robots(grid_settings)),
            placed=self.newest_scans.note,
            whose=self._whose(),
            sink_of=sink.of if grid_settings.separate_robots else None,
        )

    def _whose(self) -> Callable[[PlacedScan], Whose] | None:
        """Which share counts a placed scan; None where there is one mapper alone."""
        settings = self.grid_settings
        if settings.clip is None:
            return None
        return Ground(settings.clip, settings.lattice, settings.distances[2]).whose

    def _metrics(self) -> Metrics:
        return Metrics(
            partial(queue_metrics, self.queue),
            partial(memory_metrics, self.memory),
            lambda: ready_metric(self.health),
            lambda: () if self.kept_map is None else store_metrics(self.kept_map),
        )

    def _worker(self, settings: Settings, malformed: Callable[[Source, bytes], None]) -> Worker:
        return Worker(
            *(self.queue, self.placer, self.receipts),
            max_beams=self.limits.beams,
            overload=self.overload,
            sensors=SensorRules(settings.sensor_rules()),  # of its own: the sizes are another thread's
            malformed=malformed,
            between=(lambda: None) if self.kept_map is None else self.kept_map.offer,
        )

    def _make_watch(self) -> None:
        """What looks at the mapper while it works."""
        self.monitor = Monitor(self.live_map)
        """A thread: how the map settles, and the true world."""
        falling_behind = FallingBehind(lambda: self.queue.work, self.limits.queue_work)
        self.watch = Watch([RobotPresence(self.receipts.presence).look, falling_behind.look])
        """A thread: what an operator is told of."""
        self.reasons: list[Callable[[], str | None]] = [
            lambda: None if self.ready.is_set() else "the mapper is still starting",
            lambda: "the mapper is stopping" if self.stopping.is_set() else None,
            falling_behind.reason,
            lambda: None if self.kept_map is None else self.kept_map.failing,
        ]
        """Each tells why the mapper should get no scans now, or None; the service adds other mappers'."""
        self.health = Health(
            alive=lambda: self.worker.alive or not self.ready.is_set() or self.stopping.is_set(),
            reasons=self.reasons,
        )
        """Any thread."""

    def _make_answers(self, settings: Settings) -> None:
        """What is answered, over HTTP and Zenoh alike."""
        memory = self.memory
        self.in_flight = in_flight = InFlight(self.limits.answer_bytes, memory.left, memory.make_room)
        """Any thread."""
        kept, map_name = self.kept_map, settings.network.map_name
        answer_memory, saved = AnswerMemory(memory, in_flight), None
        if kept is not None:
            saved = SavedMaps(kept.snapshots, self.grid_settings, map_name, answer_memory)
        self.answers = Answers(
            *(map_name, self.live_map, self.receipts, self.monitor, self.ready.is_set, answer_memory),
            store=None if kept is None else kept.info,
            saved=saved,
            share=None if self.share is None else self.share.info(),
            threads=settings.mapper.thread_count,
            restored=self.restored,
        )
        """The answering threads ask."""
        self.live_updates = LiveUpdates(
            *(map_name, self.live_map, self.answers.map_tiles, self.receipts, self.newest_scans)
        )
        """One thread, the service's, asks; which moment it is, any."""
        self.writes = Writes(self.answers, self.live_map, self.grid_settings, self.worker, kept, in_flight)
        """The answering threads ask."""
        memory.add("answers", lambda: in_flight.held, in_flight.limit)
