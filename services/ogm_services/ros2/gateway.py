"""Gateway: robots' topics in, a mapper's messages out, by one worker that keeps their order."""

import logging
import math
import time
from collections.abc import Callable, Iterable
from typing import NamedTuple

from ogm_core.errors import BadCdr
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2.topics import Topic
from ogm_services.ros2.account import Account
from ogm_services.ros2.conversion import Conversion, Network
from ogm_services.ros2.inbox import Inbox, Message
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.robots import Robots
from ogm_services.ros2.topic_reading import TopicReading
from ogm_services.ros2.topic_source import TopicSource

LOOK_EVERY = 0.5
"""How often topics are looked for, s."""
IDLE = 0.1
MAX_TOPICS = 4000
"""So many are read at most."""
NO_SCANS = 10.0
"""When it is said that there are no scans at all, s."""
_NO_SCANS = (
    "no LaserScan to read has been found yet (%s): `ogm ros2 --list` shows what there is; is the domain "
    "right, and does a driver run?"
)

log = logging.getLogger(__name__)


class NamedSource(NamedTuple):
    """A source, and the name of a robot in it that has neither namespace nor prefix."""

    source: TopicSource
    otherwise: str


class Gateway:
    """Finds robots' topics on all sources, reads them, and sends poses and scans on.

    Transforms are read from the first look on, scans from the second, so that a
    robot's own tf is known before its first scan.
    """

    def __init__(
        self,
        sources: Iterable[NamedSource],
        robots: Robots,
        account: Account,
        options: Ros2Options,
        rules: SensorRules,
        pose_gap: float,
    ) -> None:
        self._sources = tuple(sources)
        self._account = account
        networks = tuple(Network(source.where, otherwise) for source, otherwise in self._sources)
        self.conversion = Conversion(networks, robots, account, options, rules, pose_gap)
        self._inbox = Inbox()
        self._readings: dict[tuple[int, str, str], TopicReading] = {}
        self._seen: set[tuple[int, str, str]] = set()
        self._next_look = 0.0
        self._no_scans_at = time.monotonic() + NO_SCANS

    def run(self, check: Callable[[], None] = lambda: None) -> None:
        """Work until an exception ends it, as KeyboardInterrupt, or one of `check`, which is called often."""
        while True:
            self.step(IDLE)
            check()

    def step(self, timeout: float) -> bool:
        """Look for topics if that is due, and handle the next message; False if none comes in time, s."""
        if time.monotonic() >= self._next_look:
            self.look()
            self.conversion.advance()
            self._next_look = time.monotonic() + LOOK_EVERY
        message = self._inbox.get(timeout)
        if message is None:
            self.conversion.advance()
            return False
        try:
            message.handle(message.payload)
        except BadCdr as error:
            self._account.dropped(message.topic, "bad_cdr", str(error))
        return True

    def look(self) -> None:
        """Subscribe to what has come; tell what was refused, or is missing."""
        now = time.monotonic()
        for number, (source, _) in enumerate(self._sources):
            publishers = [topic for topic in source.topics() if topic.publisher]
            for topic in sorted(publishers, key=lambda each: not each.qos.transient_local):
                self._found(number, topic, now)
        if not self.conversion.has_scans and now >= self._no_scans_at:
            self._no_scans_at = math.inf
            log.warning(_NO_SCANS, ", ".join(source.where for source, _ in self._sources))
        for topic_name, count in self._inbox.refused().items():
            for _ in range(count):
                self._account.dropped(topic_name, "overload", "messages come faster than they can be handled")

    def close(self) -> None:
        """Read no more."""
        for reading in self._readings.values():
            reading.close()
        self._readings.clear()

    def _found(self, number: int, topic: Topic, now: float) -> None:
        key = number, topic.name, topic.type
        if key in self._readings:
            self._readings[key].look(now)
            return
        if self.conversion.tells_poses(topic):
            self._subscribe(key, topic, always=True)
        elif self.conversion.is_scan(topic):
            if key in self._seen:
                self._subscribe(key, topic, always=False)
            self._seen.add(key)

    def _subscribe(self, key: tuple[int, str, str], topic: Topic, *, always: bool) -> None:
        handle = self.conversion.handler(key[0], topic)
        assert handle is not None

        def take(payload: bytes) -> None:
            self._inbox.put(Message(payload, handle, topic.name), always=always)

        source = self._sources[key[0]].source
        if len(self._readings) >= MAX_TOPICS:
            text = f"{MAX_TOPICS} topics are read already; --scan-topic chooses among those with scans"
            self._account.dropped(source.where, "refused", text)
            return
        self._readings[key] = TopicReading(source, topic, take, time.monotonic())
