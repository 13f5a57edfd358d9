"""Worker: the one thread that decodes messages and writes the map."""

import logging
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from functools import partial
from typing import TypeVar

from ogm_core.errors import BadMessage, OgmError
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.wire.keys import Source
from ogm_core.wire.messages import decode_pose, decode_scan
from ogm_services.mapper.intake.gathering_up import GatheringUp
from ogm_services.mapper.intake.handing_on import Placing
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.overload import Overload
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.replies.answer import Unavailable
from ogm_services.runtime.limited_log import LimitedLog

LOOK_PERIOD = 0.1
"""How often robots that have fallen silent are looked for, s."""
STOOD_STILL = 1.5
"""If there is more than this between two looks, s, the mapper stood still, or was at one scan."""
PATIENCE = 1.0
"""After that no scan is given up for so long, s, for which no pose has come meanwhile."""

log = logging.getLogger(__name__)
_T = TypeVar("_T")


class Worker:
    """Owns the scan placer, and through it the map's writing side. Started once, stopped once."""

    def __init__(
        self,
        queue: ScanQueue,
        placer: Placing,
        receipts: Receipts,
        *,
        max_beams: int,
        sensors: SensorRules | None = None,
        overload: Overload | None = None,
        between: Callable[[], None] = lambda: None,
        malformed: Callable[[Source, bytes], None] = lambda *_: None,
    ) -> None:
        """`malformed` is told of every message that cannot be read: its source and payload.

        `between` is called after every message and every look, and raises nothing.
        """
        self._between = between
        self._queue = queue
        self._placer = placer
        self._receipts = receipts
        self._max_beams = max_beams
        self._overload = overload or Overload(queue, receipts)
        self._sensors = sensors or SensorRules()
        self._malformed = malformed
        self._gathering_up = GatheringUp()
        self._complaints = LimitedLog(log)
        self._bugs = LimitedLog(log)
        self._thread = threading.Thread(target=self._run, name="ogm-worker")

    @property
    def alive(self) -> bool:
        """Whether messages are being worked on."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin to take messages from the queue."""
        self._thread.start()

    def stop(self, timeout: float | None = None) -> None:
        """Finish the scan in hand, and end, or go on after `timeout` s. Messages that wait stay pending."""
        self._queue.close()
        self._thread.join(timeout)

    def do(self, command: Callable[[], _T], timeout: float = 30.0) -> _T:
        """What `command` returns, run on the worker's thread after every message that came before.

        What it raises is raised; an OgmError is no bug.

        Raises:
            Unavailable: it was not begun in time, or the worker has stopped; it is not done any more.
        """
        outcome: Future[_T] = Future()

        def run() -> None:
            if not outcome.set_running_or_notify_cancel():
                return
            try:
                outcome.set_result(command())
            except OgmError as error:
                outcome.set_exception(error)
            except BaseException as error:
                outcome.set_exception(error)
                raise

        deadline = time.monotonic() + timeout
        self._queue.put(Message(None, b"", time.monotonic(), run))
        while not wait([outcome], LOOK_PERIOD).done:
            if (not self.alive or time.monotonic() >= deadline) and outcome.cancel():
                raise Unavailable("the mapper is stopping, or too busy: try again later")
        return outcome.result()

    def _run(self) -> None:
        looked, stood_still, patient = time.monotonic(), False, -math.inf
        while not self._queue.closed:
            # Up to `now` every message has been handled: up to the moment before an empty queue was looked
            # into, else up to the next message's arrival, however long the queue is.
            now = time.monotonic()
            item = self._next(now)
            if item is not None:
                now = item.arrival
                self._gathering_up.handled(now)
            if now - looked >= LOOK_PERIOD:
                # Who has stood still gives what has come meanwhile time to arrive, or to be asked for.
                before, stood_still = stood_still, now - looked > STOOD_STILL
                if stood_still and not before:
                    patient = now + PATIENCE
                looked = now
                if now >= patient:
                    self._survive("a look for silent robots", partial(self._placer.expire, now))
            if item is not None:
                self._handle(item)
            self._between()

    def _next(self, now: float) -> Message | None:
        """The oldest message, or None. Where many come, and all are handled, some gather first."""
        if self._gathering_up.is_worth_while(now):
            item = self._queue.take(0.0)
            if item is not None or self._queue.closed:
                return item
            self._gathering_up.pause()
        return self._queue.take(LOOK_PERIOD)

    def _handle(self, item: Message) -> None:
        """Work on a message; where others wait, tell the queue how long it took."""
        if not self._queue.behind:
            self._work_on(item)
            return
        # The time that this thread computes: how long others keep it waiting is no robot's work.
        begun = time.thread_time()
        self._work_on(item)
        self._overload.note(self._queue.worked(item, time.thread_time() - begun))

    def _work_on(self, item: Message) -> None:
        if item.command is not None:
            self._survive("a command", item.command)
        elif item.source is not None:
            robot, sensor = item.source
            try:
                if sensor is None:
                    self._take_pose(robot, item)
                else:
                    self._take_scan(robot, sensor, item)
            except Exception:  # noqa: BLE001 (logged with its traceback)
                self._bugs.failure(f"a message of {robot}/{sensor or 'pose'}")

    def _survive(self, what: str, do: Callable[[], None]) -> None:
        """Log an error that nobody meant, a bug of ours: it harms what was done, not the map."""
        try:
            do()
        except Exception:  # noqa: BLE001 (logged with its traceback)
            self._bugs.failure(what)

    def _take_pose(self, robot: str, item: Message) -> None:
        """Decode a pose and hand it to the placer; a bad one is counted."""
        try:
            message = decode_pose(item.payload)
        except BadMessage as error:
            self._receipts.pose_noted("malformed")
            self._malformed(Source(robot, None), item.payload)
            self._complaints.warning(f"{robot}/pose", str(error))
        else:
            self._placer.add_pose(robot, message, item.arrival)

    def _take_scan(self, robot: str, sensor: str, item: Message) -> None:
        """Decode a scan and hand it to the placer; a bad one is counted."""
        try:
            scan = self._sensors.read(
                f"{robot}/{sensor}", decode_scan(item.payload, max_beams=self._max_beams)
            )
        except BadMessage as error:
            self._receipts.scan_dropped(robot, sensor, "malformed")
            self._malformed(Source(robot, sensor), item.payload)
            self._complaints.warning(f"{robot}/{sensor}", str(error))
        except Exception:
            self._receipts.scan_dropped(robot, sensor, "failed")
            raise
        else:
            self._placer.add_scan(robot, sensor, scan, item.arrival)
