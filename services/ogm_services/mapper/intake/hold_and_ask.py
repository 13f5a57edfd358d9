"""Hold and ask: no message that a robot's publisher keeps is lost, and none is taken twice.

Zenoh puts a message once. What a mapper has missed, because it was away or frozen, a link broke, or a router
ended, is in the caches of the publishers, and has to be asked for before what came later is taken.
"""

import logging
import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from ogm_core.placing.rules import MAX_ROBOTS
from ogm_core.wire.heads import read_head
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.caches import Caches
from ogm_services.mapper.intake.catching_up import CatchingUp
from ogm_services.mapper.intake.handing_on import Decided, Intake
from ogm_services.mapper.intake.held import Held, HeldBytes
from ogm_services.mapper.intake.in_step import InStep
from ogm_services.mapper.intake.robot_caches import SETTLING
from ogm_services.mapper.intake.robot_hold import RobotHold

LOOK_PERIOD = 0.5
FROZEN = 1.5
"""If there is more than this between two looks, s, the mapper itself stood still: every robot is asked."""
ASKERS = 16
"""Robots that are asked at a time; and as many of those whose caches did not answer the last time."""
ASKERS_IN_STEP = 128
"""The same where robots are in step: they wait for each other."""

log = logging.getLogger(__name__)


class HoldAndAsk:
    """Stands between Zenoh's callbacks and the queue, and holds a robot back while its caches are asked.

    A robot is held, with all of its sources, when the first message of a source's run has no decided one
    before it, when a seq is not the last + 1, when the token of one of its caches appears, when a source with
    a cache is silent for SILENCE, and every robot when the mapper itself has stood still. Then its caches are
    asked, and what they keep is handed on, merged by stamps, before what is held. What is held is not yet
    received: it may come again from a cache.

    What is missing then is asked for again, and lost after that, as `CatchingUp` says. What was handed on is
    never asked for again.

    Threads: Zenoh's call `take`, which reads the head of a message and mostly hands it on; one looks every
    LOOK_PERIOD; up to ASKERS ask, each for one robot, and as many others ask those that did not answer the
    last time: nobody else waits for them. A robot's lock is held while one message of it is handed on.
    """

    def __init__(
        self,
        caches: Caches,
        decided: Decided,
        intake: Intake,
        who: str = "the mapper",
        in_step: InStep | None = None,
    ) -> None:
        """`who` holds and asks, as the log calls it. `in_step` keeps robots that are resumed in step."""
        self._who = who
        self._in_step = in_step
        self._caches = caches
        self._decided = decided
        self._intake = intake
        self._robots: dict[str, RobotHold] = {}
        self._lock = threading.Lock()
        self._bytes = HeldBytes()
        self._stopping = threading.Event()
        self._catching_up = CatchingUp(caches, intake, in_step, self._stopping)
        askers = ASKERS if in_step is None else ASKERS_IN_STEP
        self._askers = ThreadPoolExecutor(askers, "ogm-ask")
        self._patient_askers = ThreadPoolExecutor(askers, "ogm-ask-again")
        self._looker = threading.Thread(target=self._look_on, name="ogm-hold")
        self._looked = math.inf
        """When the looker looked last, s."""

    @property
    def held(self) -> int:
        """Bytes that are held, of answers, too."""
        return self._bytes.all + self._caches.held

    def start(self) -> None:
        """Hear of caches that come and go, and look for silent ones."""
        if self._in_step is not None:
            self._in_step.started()
        self._caches.declare(self.cache_changed)
        self._looker.start()

    def stop(self) -> None:
        """Hand on nothing more of what is held or asked for, and end."""
        self._stopping.set()
        self._caches.close()
        if self._looker.is_alive():
            self._looker.join()
        for askers in (self._askers, self._patient_askers):
            askers.shutdown(wait=True, cancel_futures=True)
        for robot in self._robots.values():
            robot.forget()

    def take(self, source: Source, payload: bytes, now: float) -> None:
        """Take a message as it comes: hand it on, or hold it; `now` in s of one clock."""
        robot = self._robots.get(source.robot) or self._admitted(source.robot)
        if robot is None:
            self._intake.hand_on(source, payload)  # which refuses it
            return
        # What has come while the mapper stood still comes at once: it is held, lest it fill the queue.
        stood_still = now - self._looked > FROZEN and not robot.is_held
        if stood_still:
            robot.hold()
        begins = not robot.take_next(source, payload, now) and robot.take(
            Held(source, payload, read_head(payload), now)
        )
        if begins or stood_still:
            self._ask(robot)

    def do_in_turn(self, robot: str, command: Callable[[], object]) -> None:
        """Do something after what came of a robot before."""
        known = self._robots.get(robot)
        if known is None:
            command()
        else:
            known.do_in_turn(Held(Source(robot, None), b"", None, time.monotonic(), command))

    def unread(self, source: Source) -> None:
        """Note that a message came that was counted already, and whose number nobody has read."""
        robot = self._robots.get(source.robot)
        if robot is not None:
            robot.sources.unread(source.sensor)

    def cache_changed(self, source: Source, cache: str, here: bool) -> None:
        """Note that a source's cache is there, which is asked then, or gone."""
        robot = self._robots.get(source.robot) or (self._admitted(source.robot) if here else None)
        if robot is not None and robot.cache_changed(source.sensor, cache, here, time.monotonic()):
            self._ask(robot)

    def ask_all(self) -> None:
        """Ask every robot's caches, as after a time in which the mapper stood still."""
        robots = list(self._robots.values())
        for robot in robots:  # all at once: asking takes its time
            robot.hold()
        for robot in robots:
            self._ask(robot)

    def look(self, now: float) -> None:
        """Ask robots of which a source has a cache and is silent; `now` of the clock that `take` is told."""
        for robot in list(self._robots.values()):
            if robot.sources.too_silent(now):
                self._ask(robot)

    def _look_on(self) -> None:
        self._looked = time.monotonic()
        while not self._stopping.wait(LOOK_PERIOD):
            now = time.monotonic()
            still = now - self._looked
            try:
                if still > FROZEN:
                    log.warning("%s stood still for %.1f s: robots' caches are asked", self._who, still)
                    self.ask_all()
                self.look(now)
            except Exception:
                log.exception("a look at silent robots failed")
            self._looked = now

    def _admitted(self, name: str) -> RobotHold | None:
        """A robot that is new; None if it is one too many."""
        if not self._intake.admits(name):
            return None
        with self._lock:
            if name not in self._robots and len(self._robots) >= MAX_ROBOTS:
                # One of them is forgotten where robots are counted, or another would not be admitted.
                idle = [robot for robot in self._robots.values() if not robot.at_work]
                self._robots.pop(
                    min(idle or self._robots.values(), key=lambda robot: robot.sources.heard).name
                )
            return self._robots.setdefault(name, RobotHold(name, self._decided, self._intake, self._bytes))

    def _ask(self, robot: RobotHold) -> None:
        """Have a robot's caches asked; once more if that is being done."""
        with self._lock:
            robot.again = True
            if robot.at_work or self._stopping.is_set():
                return
            robot.at_work = True
        patient = robot.caches.unanswered
        try:
            (self._patient_askers if patient else self._askers).submit(self._work, robot, patient)
        except RuntimeError:  # it was stopped in between
            robot.at_work = False

    def _work(self, robot: RobotHold, patient: bool) -> None:
        try:
            robot.hold()
            if self._in_step is not None:
                self._in_step.begin(robot.name)
            for _ in range(10):
                if not robot.caches.is_settling(time.monotonic()) or self._stopping.wait(SETTLING):
                    break
            self._catching_up.catch_up(robot, patient=patient)
        except Exception:
            log.exception("what %s has published could not be asked for", robot.name)
            robot.again, robot.fails = False, 0
            self._catching_up.drain(robot, time.monotonic())
        finally:
            if self._in_step is not None:
                self._in_step.end(robot.name)
            with self._lock:
                robot.at_work = False
            if robot.again or robot.is_held:
                self._ask(robot)
