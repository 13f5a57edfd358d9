"""Hold and ask: no message that a robot's publisher keeps is lost, and none is taken twice.

Zenoh puts a message once. What a mapper has missed, because it was away or frozen, a link broke, or a router
ended, is in the caches of the publishers, and has to be asked for before what came later is taken.
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from ogm_core.placing.rules import MAX_ROBOTS, MAX_SENSORS
from ogm_core.wire.heads import Head, read_head
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.backlog import Backlog, Unanswered
from ogm_services.mapper.intake.caches import Cached, Caches
from ogm_services.mapper.intake.numbering import Numbering, Standing

ASKS = 3
"""A gap is asked for so many times; then what is missing is lost."""
PAUSES = (0.25, 1.0)
"""Before it is asked for again, s: links and declarations come back one after the other."""
SILENCE = 5.0
"""A source that has a cache and is silent for so long is asked, s; then after twice the time, and so on."""
MOST_SILENCE = 60.0
LOOK_PERIOD = 0.5
FROZEN = 1.5
"""If there is more than this between two looks, s, the mapper itself stood still: every robot is asked."""
MAX_BYTES = 64 * 1024**2
"""What may be held of all robots, and the quarter of it of one; past that the oldest is let go of."""
ASKERS = 16
"""Robots that are asked at a time."""
SHARE = 0.25
"""What is being resumed takes this part of the queue."""
_PAUSE = 0.005
_COUNTED = 10_000
"""So many missing ones are looked at, whether they were decided; more are all missing."""
_MESSAGE_BYTES = 400
"""What a held message takes beside its payload, about."""

log = logging.getLogger(__name__)


class Decided(Protocol):
    """What was decided of robots' messages, in this life of the mapper or an earlier one. Any thread."""

    def is_decided(self, robot: str, sensor: str | None, run: str, seq: int) -> bool:
        """Whether a scan of that seq, or with None a pose, was integrated or dropped for good."""
        ...

    def last(self, robot: str, sensor: str | None, run: str) -> int | None:
        """The highest seq up to which all are decided; None if none is."""
        ...


class Intake(Protocol):
    """Where messages go, and what is told of those that do not come. Any thread."""

    def hand_on(self, source: Source, payload: bytes) -> None:
        """Count a message, and put it into the queue."""
        ...

    def admits(self, robot: str) -> bool:
        """Whether messages of that robot are taken: there may be too many."""
        ...

    def has_room(self, robot: str, robots: list[str], part: float) -> bool:
        """Whether nothing waits of a robot, or what waits of these takes less than this part of the queue."""
        ...

    def lost(self, source: Source, count: int, run: str, seqs: range) -> None:
        """Note that so many of these seqs cannot be had any more; they are decided by that."""
        ...

    def replayed(self, source: Source) -> None:
        """Note that a message came again."""
        ...


class _Held(NamedTuple):
    source: Source
    payload: bytes
    head: Head | None
    came: float
    command: Callable[[], object] | None = None
    """What is to be done in its place."""


@dataclass(slots=True, eq=False)
class _Source:
    numbering: Numbering
    heard: float
    caches: set[str] = field(default_factory=set)
    """Those whose tokens are there."""
    asked: float = 0.0
    """When it was asked for its silence, s; and how long it may then be silent until it is asked again."""
    patience: float = SILENCE
    none_of: str | None = None
    """A run that no cache keeps anything of: what is missing of it is lost at once."""


@dataclass(slots=True, eq=False)
class _Robot:
    name: str
    sources: dict[str | None, _Source] = field(default_factory=dict)
    lock: threading.RLock = field(default_factory=threading.RLock)
    held: deque[_Held] | None = None
    """What came while it is held, in order of arrival; None while it is not."""
    held_bytes: int = 0
    at_work: bool = False
    """Whether it is being asked, or about to be."""
    again: bool = False
    answered: set[str | None] | None = None
    """Sensors, None for poses, whose caches had something when asked last; None: not all answered."""


class HoldAndAsk:
    """Stands between Zenoh's callbacks and the queue, and holds a robot back while its caches are asked.

    A robot is held, with all of its sources, when the first message of a source's run has no decided one
    before it, when a seq is not the last + 1, when the token of one of its caches appears, when a source with
    a cache is silent for SILENCE, and every robot when the mapper itself has stood still. Then its caches are
    asked, and what they keep is handed on, merged by stamps, before what is held. What is held is not yet
    received: it may come again from a cache.

    What is missing then is asked for ASKS times in all, and lost after that; or at once if the cache has what
    comes before and after it, and if there is none. What was handed on is never asked for again.

    Threads: Zenoh's call `take`, which reads the head of a message and mostly hands it on; one looks every
    LOOK_PERIOD; up to ASKERS ask, each for one robot. A robot's lock is held while one message of it is
    handed on.
    """

    def __init__(self, caches: Caches, decided: Decided, intake: Intake) -> None:
        self._caches = caches
        self._decided = decided
        self._intake = intake
        self._robots: dict[str, _Robot] = {}
        self._lock = threading.Lock()
        self._held = 0
        self._working: dict[str, None] = {}
        """Robots whose backlog is being handed on."""
        self._stopping = threading.Event()
        self._askers = ThreadPoolExecutor(ASKERS, "ogm-ask")
        self._looker = threading.Thread(target=self._look_on, name="ogm-hold")

    @property
    def held(self) -> int:
        """Bytes that are held, of answers, too."""
        return self._held + self._caches.held

    def start(self) -> None:
        """Begin to look; before that, robots' messages are taken."""
        self._caches.declare(self.cache_changed)
        self._looker.start()

    def stop(self) -> None:
        """Hand on nothing more of what is held or asked for, and end."""
        self._stopping.set()
        self._caches.close()
        if self._looker.is_alive():
            self._looker.join()
        self._askers.shutdown(wait=True, cancel_futures=True)

    def take(self, source: Source, payload: bytes, now: float) -> None:
        """Take a message as it comes: hand it on, or hold it."""
        robot = self._robots.get(source.robot) or self._admitted(source.robot)
        known = None if robot is None else self._source(robot, source, now)
        if robot is None or known is None:
            self._intake.hand_on(source, payload)  # which refuses it
            return
        item = _Held(source, payload, read_head(payload), now)
        with robot.lock:
            known.heard, known.patience = now, SILENCE
            if robot.held is None and self._handed_on(robot, known, item):
                return
            begins = robot.held is None
            self._hold(robot, item)
        if begins:
            self._ask(robot)

    def do_in_turn(self, robot: str, command: Callable[[], object]) -> None:
        """Do something after what came of a robot before."""
        known = self._robots.get(robot)
        if known is not None:
            with known.lock:
                if known.held is not None:
                    self._hold(known, _Held(Source(robot, None), b"", None, time.monotonic(), command))
                    return
        command()

    def unread(self, source: Source) -> None:
        """Note that a message came that was counted already, and whose number nobody has read."""
        robot = self._robots.get(source.robot)
        known = None if robot is None else robot.sources.get(source.sensor)
        if known is not None:
            known.numbering.unread += 1

    def cache_changed(self, source: Source, cache: str, here: bool) -> None:
        """Note that a source's cache is there, which is asked then, or gone."""
        robot = self._robots.get(source.robot) or (self._admitted(source.robot) if here else None)
        known = None if robot is None else self._source(robot, source, time.monotonic())
        if robot is None or known is None:
            return
        if not here:
            known.caches.discard(cache)
            return
        known.caches.add(cache)
        known.none_of = None
        self._ask(robot)

    def ask_all(self) -> None:
        """Ask every robot's caches, as after a time in which the mapper stood still."""
        for robot in list(self._robots.values()):
            self._ask(robot)

    def look(self, now: float) -> None:
        """Ask sources that have a cache and are silent; `now` of the clock that `take` is told."""
        for robot in list(self._robots.values()):
            for known in list(robot.sources.values()):
                if known.caches and now - max(known.heard, known.asked) > known.patience:
                    known.asked, known.patience = now, min(2.0 * known.patience, MOST_SILENCE)
                    self._ask(robot)

    def _look_on(self) -> None:
        looked = time.monotonic()
        while not self._stopping.wait(LOOK_PERIOD):
            now = time.monotonic()
            try:
                if now - looked > FROZEN:
                    log.warning("the mapper stood still for %.1f s: robots' caches are asked", now - looked)
                    self.ask_all()
                self.look(now)
            except Exception:
                log.exception("a look at silent robots failed")
            looked = now

    def _admitted(self, name: str) -> _Robot | None:
        if not self._intake.admits(name):
            return None
        with self._lock:
            if name not in self._robots and len(self._robots) >= MAX_ROBOTS:
                # One of them is forgotten where robots are counted, or another would not be admitted.
                idle = [robot for robot in self._robots.values() if not robot.at_work]
                del self._robots[min(idle or self._robots.values(), key=_heard).name]
            return self._robots.setdefault(name, _Robot(name))

    def _source(self, robot: _Robot, source: Source, now: float) -> _Source | None:
        """What is known of a source; None if it is one sensor too many."""
        sensor = source.sensor
        known = robot.sources.get(sensor)
        if known is None:
            with robot.lock:
                sensors = sum(name is not None for name in robot.sources)
                if sensor is None or sensors < MAX_SENSORS:
                    numbering = Numbering(lambda run: self._decided.last(robot.name, sensor, run))
                    known = robot.sources.setdefault(sensor, _Source(numbering, now))
        return known

    def _hold(self, robot: _Robot, item: _Held) -> None:
        """Keep a message until its robot's caches are asked; past what may be held, the oldest goes."""
        if robot.held is None:
            robot.held = deque()
        robot.held.append(item)
        self._count(robot, item, 1)
        while len(robot.held) > 1 and (robot.held_bytes > MAX_BYTES / 4 or self._held > MAX_BYTES):
            gone = robot.held.popleft()
            self._count(robot, gone, -1)
            if gone.command is not None:
                gone.command()
            elif gone.head is None or not gone.head[2]:
                self._intake.lost(gone.source, 1, "", range(0))  # the others are missed when their turn comes

    def _count(self, robot: _Robot, item: _Held, sign: int) -> None:
        size = sign * (len(item.payload) + _MESSAGE_BYTES)
        robot.held_bytes += size
        with self._lock:
            self._held += size

    def _ask(self, robot: _Robot) -> None:
        """Have a robot's caches asked; once more if that is being done."""
        with self._lock:
            robot.again = True
            if robot.at_work or self._stopping.is_set():
                return
            robot.at_work = True
        try:
            self._askers.submit(self._work, robot)
        except RuntimeError:  # it was stopped in between
            robot.at_work = False

    def _work(self, robot: _Robot) -> None:
        try:
            with robot.lock:
                if robot.held is None:
                    robot.held = deque()
            self._catch_up(robot)
        except Exception:
            log.exception("what %s has published could not be asked for", robot.name)
            robot.again = False
            self._drain(robot, time.monotonic())
        finally:
            with self._lock:
                robot.at_work = False
            if robot.again or robot.held is not None:
                self._ask(robot)

    def _catch_up(self, robot: _Robot) -> None:
        """Ask, and hand on what is held, until nothing is missing and nothing is held."""
        fails = 0
        while not self._stopping.is_set():
            robot.again, began = False, time.monotonic()
            progress = self._hand_on_backlog(robot, final=fails == ASKS - 1)
            gap = self._drain(robot, None)
            if gap and not progress:
                fails += 1
                if fails < ASKS:
                    self._stopping.wait(PAUSES[fails - 1])
                    continue
                self._drain(robot, began)
            fails = 0
            if robot.held is None:
                return

    def _hand_on_backlog(self, robot: _Robot, *, final: bool) -> bool:
        """Hand on what the robot's caches keep; whether there was anything new."""
        progress, robot.answered = False, None

        def wanted(source: Source, run: str) -> int | None:
            known = self._source(robot, source, time.monotonic())
            last = None if known is None else known.numbering.last(run)
            return None if last is None else last + 1

        self._working[robot.name] = None
        try:
            with closing(Backlog(self._caches, robot.name, wanted)) as backlog:
                for message, all_there in backlog.messages():
                    progress |= self._handed_on_cached(robot, message, all_there or final)
                    if self._stopping.is_set():
                        return False
                robot.answered = {source.sensor for source in backlog.sources}
        except Unanswered:
            pass
        finally:
            del self._working[robot.name]
        return progress

    def _handed_on_cached(self, robot: _Robot, message: Cached, all_there: bool) -> bool:
        """Hand on a message out of a cache, unless that was done; whether it was new.

        `all_there`: what is missing before it is not in the cache.
        """
        source = message.source
        known = self._source(robot, source, time.monotonic())
        if known is None:
            return False
        if message.head is None:
            known.numbering.unread += 1
            return False
        stamp, seq, run = message.head
        if run == "":
            return False  # nobody can tell whether it was handed on
        standing = known.numbering.standing(run, seq)
        if standing is Standing.GAP and not all_there:
            raise Unanswered
        if standing is Standing.OLD:
            self._intake.replayed(source)
            return False
        decided = self._decided.is_decided(source.robot, source.sensor, run, seq)
        self._give_up(source, run, known.numbering.take(run, seq, twin=stamp))
        if decided:
            self._intake.replayed(source)
        else:
            while not (self._stopping.is_set() or self._has_room(robot)):
                self._stopping.wait(_PAUSE)
            if not self._stopping.is_set():
                self._intake.hand_on(source, message.payload)
        return True

    def _has_room(self, robot: _Robot) -> bool:
        return self._intake.has_room(robot.name, list(self._working), SHARE)

    def _drain(self, robot: _Robot, until: float | None) -> bool:
        """Hand on what is held, up to a gap, which ends it; what came up to `until` whatever is missing.

        Whether it has met a gap. Without one the robot is held no longer, unless it is to be asked again.
        """
        while not self._stopping.is_set():
            with robot.lock:
                if not robot.held:
                    robot.held = robot.held if robot.again else None
                    return False
                item = robot.held[0]
                forced = until is not None and item.came <= until
                if item.command is not None:
                    item.command()
                elif not self._handed_on(robot, robot.sources[item.source.sensor], item, forced=forced):
                    return True
                robot.held.popleft()
                self._count(robot, item, -1)
        return False

    def _handed_on(self, robot: _Robot, known: _Source, item: _Held, *, forced: bool = False) -> bool:
        """Hand on a message that came by itself, unless others are missing before it; `forced`: even then."""
        source, numbering = item.source, known.numbering
        if item.head is None:
            numbering.unread += 1
            self._intake.hand_on(source, item.payload)
            return True
        stamp, seq, run = item.head
        standing = numbering.standing(run, seq)
        if standing is Standing.OLD:
            if numbering.is_twin(run, seq, stamp):
                self._intake.replayed(source)
            else:
                self._intake.hand_on(source, item.payload)
            return True
        if (standing is Standing.GAP or standing is Standing.BEGINNING) and known.none_of != run:
            if not forced:
                return False
            if robot.answered is not None and source.sensor not in robot.answered and not known.caches:
                known.none_of = run
        self._give_up(source, run, numbering.take(run, seq))
        self._intake.hand_on(source, item.payload)
        return True

    def _give_up(self, source: Source, run: str, seqs: range) -> None:
        """Count what is missing for good, but for what was decided in an earlier life."""
        if not seqs:
            return
        count = len(seqs)
        if count <= _COUNTED:
            is_decided = self._decided.is_decided
            count -= sum(is_decided(source.robot, source.sensor, run, seq) for seq in seqs)
        if count:
            self._intake.lost(source, count, run, seqs)


def _heard(robot: _Robot) -> float:
    return max((known.heard for known in robot.sources.values()), default=0.0)
