"""The one thread that decodes messages and writes the map."""

import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait

from ogm_core.errors import BadMessage
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.wire.messages import decode_pose, decode_scan
from ogm_services.mapper.intake.queue import Message, ScanQueue
from ogm_services.replies.answer import Unavailable
from ogm_services.runtime.limited_log import LimitedLog

LOOK_PERIOD = 0.1
"""How often robots that have fallen silent are looked for, s."""

log = logging.getLogger(__name__)


class Worker:
    """Owns the mapper, and through it the map's writing side. Started once, stopped once."""

    def __init__(
        self, queue: ScanQueue, mapper: ScanPlacer, receipts: Receipts, *, max_beams: int, pose_wait: float
    ) -> None:
        self._queue = queue
        self._mapper = mapper
        self._receipts = receipts
        self._max_beams = max_beams
        self._pose_wait = pose_wait
        self._complaints = LimitedLog(log)
        self._thread = threading.Thread(target=self._run, name="ogm-worker")

    @property
    def alive(self) -> bool:
        """Whether messages are being worked on."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin to take messages from the queue."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the message in hand, and end. Messages that still wait stay pending."""
        self._queue.close()
        self._thread.join()

    def do(self, command: Callable[[], None], timeout: float = 30.0) -> None:
        """Run `command` on the worker's thread, after every message that came before; wait until it is done.

        Raises:
            Unavailable: it was not begun in time, or the worker has stopped; it may still be done.
        """
        outcome: Future[None] = Future()

        def run() -> None:
            try:
                command()
            except Exception as error:
                outcome.set_exception(error)
                raise
            outcome.set_result(None)

        deadline = time.monotonic() + timeout
        self._queue.put(Message(None, b"", time.monotonic(), run))
        while not outcome.done():
            if not self.alive or time.monotonic() >= deadline:
                raise Unavailable("the mapper is stopping, or too busy: try again later")
            wait([outcome], LOOK_PERIOD)
        outcome.result()

    def _run(self) -> None:
        looked = time.monotonic()
        while not self._queue.closed:
            # Up to `now` every message has been handled: up to the moment before an empty queue was looked
            # into, else up to the next message's arrival, however long the queue is.
            now = time.monotonic()
            item = self._queue.take(LOOK_PERIOD)
            if item is not None:
                now = item.arrival
            if now - looked >= LOOK_PERIOD:
                self._mapper.expire(now, self._pose_wait)
                looked = now
            if item is not None:
                try:
                    self._work_on(item)
                except Exception:
                    # A bug of ours: its traceback is kept, and it harms one message, not the map.
                    log.exception(
                        "%s failed", "a command" if item.source is None else f"a message of {item.source}"
                    )

    def _work_on(self, item: Message) -> None:
        if item.command is not None:
            item.command()
        elif item.source is not None:
            self._handle(item, *item.source)

    def _handle(self, item: Message, robot: str, sensor: str | None) -> None:
        """Decode a message and hand it to the mapper; a bad one is counted."""
        self._mapper.heard(robot, item.arrival)
        try:
            if sensor is None:
                self._mapper.add_pose(robot, decode_pose(item.payload))
            else:
                self._mapper.add_scan(robot, sensor, decode_scan(item.payload, max_beams=self._max_beams))
        except BadMessage as error:
            self._refuse(robot, sensor)
            self._complaints.warning(f"{robot}/{sensor or 'pose'}", str(error))

    def _refuse(self, robot: str, sensor: str | None) -> None:
        if sensor is None:
            self._receipts.pose_refused("malformed")
        else:
            self._receipts.scan_dropped(robot, sensor, "malformed")
