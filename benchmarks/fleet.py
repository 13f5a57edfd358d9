"""What a fleet costs the mapper: from the queue's entrance to the map, in one process and without network."""

import math
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack

import numpy as np

from benchmarks.growth import Case, Costs, Factor, Floats, best_of, place
from ogm_core.placing.placement import ScanSink
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.rules import PlacingRules
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import Pose, PoseStamped, Scan, Sweep
from ogm_core.wire.keys import Source
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS, encode_pose, encode_scan
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.worker import Worker
from ogm_services.mapper.live.live_map import LiveMap

ROBOTS = Factor("robots", (1, 2, 4, 8, 16, 32, 64), (1, 64), 1)
RATE = 10
"""Poses, and scans, that a robot sends a second."""
CASE = Case(beams=360, side=4096)
"""Every robot drives in a map that is known, in which all of them are scattered."""
NO_MAP = "no map"
"""The service alone: nobody integrates the scans."""
SECOND = 1_000_000_000
BATCHES, LEAST_SCANS = 8, 16
"""What a round times, one after the other: all robots' messages, again until there are so many scans."""


class NoMap:
    """Takes scans and does nothing with them."""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Update no cell."""
        del scan, pose, sweep
        return 0


class Fleet:
    """Robots, and the mapper that they send to. A context manager: the mapper's worker is a thread."""

    def __init__(self, robots: int, sink: ScanSink) -> None:
        self._ticks = math.ceil(LEAST_SCANS / robots)
        self._rng = np.random.default_rng(robots)
        margin = CASE.reach + 2.0
        far = CASE.side * CASE.resolution - margin
        self._poses = [
            Pose(*self._rng.uniform((margin, margin, 0.0), (far, far, 6.0))) for _ in range(robots)
        ]
        self._tick = 0
        self.receipts = Receipts()
        self._queue = ScanQueue(robots * self._ticks)
        placer = ScanPlacer(sink, self.receipts, lambda *_: None, PlacingRules(pose_wait=math.inf))
        self._worker = Worker(self._queue, placer, self.receipts, max_beams=DEFAULT_MAX_BEAMS)

    def __enter__(self) -> "Fleet":
        self._worker.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._worker.stop()

    def round(self) -> Floats:
        """CPU time of a second of the fleet, s, by each batch: receiving and working, in two threads."""
        return np.array([self._batch() for _ in range(BATCHES)]) / self._ticks * RATE

    def _batch(self) -> float:
        messages = [message for _ in range(self._ticks) for message in self._moved()]
        worked: list[float] = []
        self._worker.do(lambda: worked.append(time.thread_time()))
        begin = time.thread_time()
        for source, payload in messages:
            self._receive(source, payload)
        received = time.thread_time() - begin
        self._worker.do(lambda: worked.append(time.thread_time()))
        return received + worked[1] - worked[0]

    def _receive(self, source: Source, payload: bytes) -> None:
        """As the subscriber's callback does."""
        if source.sensor is None:
            self.receipts.pose_received(source.robot)
        else:
            self.receipts.scan_received(source.robot, source.sensor)
        self._queue.put(Message(source, payload, time.monotonic()))

    def _moved(self) -> list[tuple[Source, bytes]]:
        """A pose and a scan of every robot, a tick later."""
        self._tick += 1
        stamp = self._tick * SECOND // RATE
        messages = []
        for n, (x, y, theta) in enumerate(self._poses):
            pose = Pose(x + self._rng.uniform(-0.5, 0.5), y, theta)
            scan = place(CASE.beams, CASE.reach, pose, self._rng, stamp).scan
            messages.append((Source(f"robot{n}", None), encode_pose(PoseStamped(stamp, pose, self._tick))))
            messages.append((Source(f"robot{n}", "laser"), encode_scan(scan)))
        return messages


def sink_of(variant: str) -> ScanSink:
    """What the scans go to: a map in one of the variants, or nothing."""
    return NoMap() if variant == NO_MAP else LiveMap(CASE.grid(variant))


def measured_fleets(variants: Iterable[str], rounds: int) -> Costs:
    """CPU time of a second of a fleet, s."""
    with ExitStack() as running:
        jobs: dict[tuple[str, str, int], Callable[[], Floats]] = {}
        for variant in variants:
            sink = sink_of(variant)
            for n, robots in enumerate(ROBOTS.values):
                jobs[ROBOTS.name, variant, n] = running.enter_context(Fleet(int(robots), sink)).round
        return best_of(jobs, rounds)
