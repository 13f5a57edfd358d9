"""Hold of one robot: what came of it while its caches are asked, and which of its messages were handed on."""

import math
import threading
import time
from collections.abc import Callable

from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.backlog import Unanswered
from ogm_services.mapper.intake.caches import Cached
from ogm_services.mapper.intake.handing_on import Decided, Intake, WhyLost
from ogm_services.mapper.intake.held import Held, HeldBytes, HeldMessages
from ogm_services.mapper.intake.held_source import HeldSource
from ogm_services.mapper.intake.numbering import Numbering, Standing
from ogm_services.mapper.intake.robot_caches import RobotCaches
from ogm_services.mapper.intake.robot_sources import RobotSources

_COUNTED = 10_000
"""So many missing ones are looked at, whether they were decided; more are all missing."""


class RobotHold:
    """The messages of one robot on their way to the queue.

    While it is held, what comes is kept, and what its caches say goes before. One thread at a time hands on:
    Zenoh's, under `lock`, while it is not held, else the one that asks.
    """

    def __init__(self, name: str, decided: Decided, intake: Intake, held_bytes: HeldBytes) -> None:
        self.name = name
        self.lock = threading.RLock()
        self.at_work = False
        """Whether it is being asked, or about to be."""
        self.again = False
        """Whether it is to be asked once more."""
        self.fails = 0
        """How often in a row it was asked in vain for what is missing."""
        self._decided = decided
        self._intake = intake
        self._held = HeldMessages(held_bytes)
        self.is_held = False
        """Whether what comes is kept."""
        self.sources = RobotSources(name, decided, self.lock)
        self.caches = RobotCaches(self.sources.by_sensor)

    @property
    def held_stamp(self) -> int | None:
        """Stamp of the oldest message that is held, ns; None if there is none, or nobody can read it."""
        with self.lock:
            head = self._held.oldest.head if self._held else None
        return None if head is None else head[0]

    def hold(self) -> None:
        """From now on keep what comes."""
        with self.lock:
            if not self.is_held:
                self.is_held = True
                self._decided.wait_on(self.name, math.inf)

    def take_next(self, source: Source, payload: bytes, now: float) -> bool:
        """Hand on a message that comes by itself, if a glance tells that nothing is missing before it."""
        known = self.sources.by_sensor.get(source.sensor)
        if known is None:
            return False
        with self.lock:
            if self.is_held or not known.numbering.take_next(payload):
                return False
            known.heard = now
            self._intake.hand_on(source, payload)
        return True

    def take(self, item: Held) -> bool:
        """Hand on a message that comes by itself, or hold it; whether the robot is to be asked for it."""
        known = self.sources.admitted(item.source.sensor, item.came)
        if known is None:
            self._intake.hand_on(item.source, item.payload)  # which refuses it
            return False
        with self.lock:
            known.heard = item.came
            if not self.is_held and self._handed_on(known, item):
                return False
            begins = not self.is_held
            self._keep(item)
        return begins

    def do_in_turn(self, item: Held) -> None:
        """Do a command after what has come."""
        assert item.command is not None
        with self.lock:
            if self.is_held:
                self._keep(item)
                return
        item.command()

    def cache_changed(self, sensor: str | None, cache: str, here: bool, now: float) -> bool:
        """Note that a cache is there, or gone; whether the robot is to be asked because of it."""
        known = self.sources.admitted(sensor, now)
        if known is None:
            return False
        with self.lock:
            self.caches.note(known, cache, here, now)
            if not here and not self.is_held:
                self._decided.wait_on(self.name, self.caches.back)
        return here

    def take_cached(self, message: Cached, now: float, room: Callable[[], bool], *, follows: bool) -> bool:
        """Hand on a message out of a cache, unless that was done; whether it was new.

        What came by itself while the robot is held is handed on from there, before the first message of a
        later stamp: it is in the order in which it was published, poses before the scans that need them,
        whenever each cache answered.

        `room` waits until there is some; False: it is not to be handed on. `follows`: the cache has nothing
        of what is missing before it.

        Raises:
            Unanswered: something is missing before it that the cache may have.
        """
        source, known = message.source, self.sources.admitted(message.source.sensor, now)
        if known is None:
            return False
        if message.head is None:
            known.numbering.unread += 1
            return False
        stamp, seq, run = message.head
        if run == "":
            return False  # nobody can tell whether it was handed on
        standing = known.numbering.standing(run, seq)
        if standing is Standing.GAP and not follows:
            raise Unanswered
        if standing is Standing.OLD:
            self._intake.replayed(source)
            return False
        if self._is_held_too(source, run, seq, known.numbering):
            return False
        self._drain_before(stamp, source, room)
        with self.lock:
            first = self._held.first(source.sensor, run)
        if first is not None and first < seq:
            self.again = True  # what is held before it cannot be handed on yet
            return False
        if self._decided.is_decided(*source, run, seq):
            self._intake.replayed(source)
        elif room():
            self._intake.hand_on(source, message.payload, resumed=True)
        else:
            return False
        self._give_up(source, run, known.numbering.take(run, seq, twin=stamp))
        return True

    def drain(self, room: Callable[[], bool], until: float | None = None) -> tuple[bool, bool]:
        """Hand on what is held, up to a gap, which ends it; what came up to `until` whatever is missing.

        Whether it has met a gap, and whether anything was handed on. Without a gap the robot is held no
        longer, unless it is to be asked again. `room` waits until there is some; False: nothing is handed on
        any more.
        """
        progress = False
        while True:
            if self._held and not room():
                return False, progress
            with self.lock:
                if not self._held:
                    if not self.again:
                        self.is_held = False
                        self._decided.wait_on(self.name, max(time.monotonic(), self.caches.back))
                    return False, progress
                item = self._held.oldest
                if item.command is not None:
                    item.command()
                else:
                    forced = until is not None and item.came <= until
                    if not self._handed_on(self.sources.by_sensor[item.source.sensor], item, forced=forced):
                        return True, progress
                    progress = True
                self._held.pop()

    def forget(self) -> None:
        """Let go of what is held."""
        with self.lock:
            while self._held:
                self._held.pop()

    def _is_held_too(self, source: Source, run: str, seq: int, numbering: Numbering) -> bool:
        """Whether a message of a cache is held, too; what is missing before the first one is given up."""
        with self.lock:
            held, first = self._held.has(source.sensor, run, seq), self._held.first(source.sensor, run)
        if held and seq == first and numbering.standing(run, seq) in (Standing.GAP, Standing.BEGINNING):
            self._give_up(source, run, numbering.begin_at(run, seq))
        return held

    def _drain_before(self, stamp: int, source: Source, room: Callable[[], bool]) -> None:
        """Hand on what is held and comes before a message of that stamp, up to a gap or a command."""
        turn = stamp, source.sensor is not None
        while self._held and room():
            with self.lock:
                if not self._held:
                    return
                item = self._held.oldest
                if item.command is not None:
                    return
                if item.head is not None and (item.head[0], item.source.sensor is not None) >= turn:
                    return
                if not self._handed_on(self.sources.by_sensor[item.source.sensor], item):
                    return
                self._held.pop()

    def _handed_on(self, known: HeldSource, item: Held, *, forced: bool = False) -> bool:
        """Hand on a message that came by itself, unless others are missing before it; `forced`: even then."""
        source, numbering = item.source, known.numbering
        if item.head is None:
            numbering.unread += 1
            self._intake.hand_on(source, item.payload, resumed=self.is_held)
            return True
        stamp, seq, run = item.head
        standing = numbering.standing(run, seq)
        if standing is Standing.OLD:
            if numbering.is_twin(run, seq, stamp):
                self._intake.replayed(source)
            else:
                self._intake.hand_on(source, item.payload, resumed=self.is_held)
            return True
        if (standing is Standing.GAP or standing is Standing.BEGINNING) and known.none_of != run:
            if not forced:
                return False
            answered = self.caches.answered
            if answered is not None and source.sensor not in answered and not known.caches:
                known.none_of = run
        why: WhyLost = "no answer" if self.caches.unanswered else "not kept"
        self._give_up(source, run, numbering.take(run, seq), why)
        self._intake.hand_on(source, item.payload, resumed=self.is_held)
        return True

    def _keep(self, item: Held) -> None:
        """Hold a message; past what may be held, the oldest goes: it is missed when its turn comes."""
        self.hold()
        self._held.append(item)
        while self._held.too_many:
            gone = self._held.pop()
            if gone.command is not None:
                gone.command()
            elif gone.head is None or not gone.head[2]:
                self._intake.lost(gone.source, 1, "", range(0), "not held")  # nobody would miss it
                if gone.source.sensor is not None:
                    self._decided.drop_unnumbered(gone.source.robot, gone.source.sensor, "lost")

    def _give_up(self, source: Source, run: str, seqs: range, why: WhyLost = "not kept") -> None:
        """Count what is missing for good, but for what was decided in an earlier life."""
        if not seqs:
            return
        count = len(seqs)
        if count <= _COUNTED:
            count -= sum(self._decided.is_decided(*source, run, seq) for seq in seqs)
        if count:
            self._intake.lost(source, count, run, seqs, why)
            self._decided.skip(*source, run, seqs[0], seqs[-1], count=count)
