"""Recorder: hears a map's robots as a mapper does, holds and asks as it does, and writes what it takes."""

import math
import time
from contextlib import ExitStack
from types import TracebackType
from typing import Self

import zenoh

from ogm_core.placing.receipts import Receipts
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.wire.keys import MapKeys
from ogm_services.mapper.intake.overload import Overload
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.worker import Worker
from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber
from ogm_services.recorder.message_sink import MessageSink
from ogm_services.settings.settings import Settings

SETTLING = 3.0
"""How long, at the end, robots may still be asked for what was missed, s."""
_POLL = 0.02
_NAMED = 5
"""So many robots are named, more are counted."""
_CURE = "send fewer scans or beams, or record on a faster machine"


class Recorder:
    """Records from the begin of its `with` to the end, in which what has come is written.

    The order in the file is that in which a mapper on the same session would take the messages. Threads are
    a mapper's: Zenoh's put messages into a queue, askers ask robots' caches, one worker writes.
    """

    def __init__(self, session: zenoh.Session, settings: Settings, writer: McapWriter) -> None:
        limits = settings.mapper
        self.receipts = Receipts()
        """What became of every message; any thread."""
        self.sink = MessageSink(writer, self.receipts)
        queue = ScanQueue(limits.queue)
        overload = Overload(queue, self.receipts, cure=_CURE)
        self._worker = Worker(
            *(queue, self.sink, self.receipts),
            max_beams=limits.max_beams,
            overload=overload,
            between=lambda: self.sink.flush(time.monotonic()),
        )
        self._subscriber = ZenohSubscriber(
            *(session, MapKeys(settings.network.map_name), queue, self.receipts, self.sink),
            max_beams=limits.max_beams,
            overload=overload,
            who="the recorder",
        )
        self._open = ExitStack()

    def counted(self) -> str:
        """How much of how many robots is in the file, and what is missing, in words."""
        sink = self.sink
        scans, poses = (sink.scans, sink.poses) if sink.failure is None else sink.safe
        counts = self.receipts.status()
        names = sorted(sink.robots)
        of = ", ".join(names) if 0 < len(names) <= _NAMED else f"{len(names)} robots"
        parts = [f"{scans} scans and {poses} poses of {of}"]
        dropped = counts.scans.dropped
        parts += [f"{count} scans dropped: {reason}" for reason, count in dropped.items() if count]
        parts += [
            f"{count} poses {what}"
            for what, count in (("malformed", counts.poses.malformed), ("refused", counts.poses.refused))
            if count
        ]
        parts += [
            f"{count} {what} lost"
            for what, count in (("scans", counts.scans.lost), ("poses", counts.poses.lost))
            if count
        ]
        return ", ".join(parts)

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            self._worker.start()
            opening.callback(self._worker.stop)
            opening.callback(self._subscriber.close)
            self._subscriber.declare()
            self._open = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._open:
            if self.sink.failure is not None:
                return
            deadline = time.monotonic() + SETTLING
            while self._subscriber.hold.held and time.monotonic() < deadline:
                time.sleep(_POLL)
            self._subscriber.close()
            self._worker.do(self.sink.flush, math.inf)
