"""Zenoh subscriber of a mapper or recorder, its only one for messages: it counts them and queues them."""

import logging
import time
from contextlib import ExitStack
from functools import lru_cache, partial

import zenoh

from ogm_core.placing.reasons import too_many_robots
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.scan_placer import ROBOTS
from ogm_core.wire.keys import MapKeys
from ogm_services.mapper.intake.caches import Caches
from ogm_services.mapper.intake.handing_on import Placing
from ogm_services.mapper.intake.hold_and_ask import HoldAndAsk
from ogm_services.mapper.intake.in_step import InStep
from ogm_services.mapper.intake.message import Message
from ogm_services.mapper.intake.overload import Overload
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.intake.reception import Reception
from ogm_services.runtime.limited_log import LimitedLog

REMEMBERED_KEYS = 1000
"""Keys of messages whose sources are remembered; reading one anew does no harm."""
MAX_KEY = 256
"""Longer than any key of a message, characters: such a one is not even remembered."""

log = logging.getLogger(__name__)


class ZenohSubscriber:
    """Takes poses and scans alike, so that their order is kept, until `close`.

    Zenoh's thread calls the callbacks, which count and enqueue, and decode a message's head at most: they
    would hold up the link. They do so where a pose has to wait for room: that slows down who sends too many.
    What is longer than any message of its kind, a scan of `max_beams` or a pose, is not even copied. The
    robots' liveliness tokens take the same way, so that the worker hears of a robot's end after what came
    before it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: MapKeys,
        queue: ScanQueue,
        receipts: Receipts,
        placer: Placing,
        *,
        max_beams: int,
        overload: Overload | None = None,
        who: str = "the mapper",
        in_step: InStep | None = None,
    ) -> None:
        """`who` listens, as the log calls it. `in_step` keeps robots that are resumed in step."""
        self._session = session
        self._placer = placer
        self._keys = keys
        self._source_of = lru_cache(REMEMBERED_KEYS)(keys.source_of)
        self._queue = queue
        self._receipts = receipts
        self._reception = Reception(queue, receipts, max_beams=max_beams, overload=overload)
        caches = Caches(session, keys, self._reception.longest)
        self.hold = HoldAndAsk(caches, placer.decided, self._reception, who, in_step)
        """What holds robots back while they are asked for what was missed."""
        self._complaints = LimitedLog(log)
        self._declared = ExitStack()

    def declare(self) -> None:
        """Declare the subscriber: from here on nothing that is put is missed."""
        self._declared.callback(self.hold.stop)
        self.hold.start()
        tokens = zenoh.handlers.Callback(self._token_changed, indirect=False)
        alive = self._keys.alive("robot", "*", "*")
        self._declared.push(self._session.liveliness().declare_subscriber(alive, tokens, history=True))
        callback = zenoh.handlers.Callback(self._received, indirect=False)
        self._declared.push(self._session.declare_subscriber(self._keys.robots, callback))

    def close(self) -> None:
        """Undeclare it: nothing more comes in."""
        self._declared.close()

    def _received(self, sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        source = self._source_of(key) if len(key) <= MAX_KEY else None
        if source is None or sample.kind != zenoh.SampleKind.PUT:
            self._receipts.ignored()
            return
        length = len(sample.payload)
        if length > self._reception.longest(source):
            self._reception.refuse_long(source, length)
            self.hold.unread(source)
            if source.sensor is not None:
                self._placer.decided.drop_unnumbered(source.robot, source.sensor, "malformed")
        else:
            self.hold.take(source, sample.payload.to_bytes(), time.monotonic())

    def _token_changed(self, sample: zenoh.Sample) -> None:
        """Have the worker told, after the messages that have come, that a robot's run is there or gone."""
        found = self._keys.robot_of(str(sample.key_expr))
        if found is None:
            return
        now = time.monotonic()
        here = sample.kind == zenoh.SampleKind.PUT
        if here and not self._receipts.admits(found.robot, now):
            self._complaints.warning(ROBOTS, too_many_robots(found.robot).text)
            return
        note = self._placer.robot_here if here else self._placer.robot_gone
        told = partial(note, found.robot, found.run, now)
        put = partial(self._queue.put, Message(None, b"", now, told, robot=found.robot))
        self.hold.do_in_turn(found.robot, put)
