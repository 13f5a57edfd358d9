"""Catching up: what one robot's caches keep is asked for and handed on, and what was held meanwhile."""

import math
import threading
import time
from contextlib import closing
from functools import partial

from ogm_services.mapper.intake.backlog import Backlog, Unanswered
from ogm_services.mapper.intake.caches import Caches
from ogm_services.mapper.intake.handing_on import Intake
from ogm_services.mapper.intake.in_step import InStep
from ogm_services.mapper.intake.robot_hold import RobotHold

ASKS = 3
"""A gap is asked for so many times; then what is missing is lost."""
PAUSES = (0.25, 1.0)
"""Before it is asked for again, s: links and declarations come back one after the other."""
SHARE = 0.25
"""What is being resumed takes this part of the queue, or one message of each robot."""
PATIENCE = 10.0
"""What is held waits so long for that, s: a mapper that has more to do than it can will not have room."""
_PAUSE = 0.005


class CatchingUp:
    """What is done for a robot that is held, by one thread at a time for each.

    What is missing is asked for ASKS times in all, and lost after that; or at once if the cache has what
    comes before and after it, and if there is none. A robot whose caches have gone, or are there and do not
    answer, as on a machine that has far too much to do, is waited for before these times are counted, for as
    long as `RobotCaches` says.

    What is resumed, out of a cache or held, waits for room: a part of the queue is for all of it. A cache
    that is there, or must be, and does not answer is asked again before anything of its robot is handed on.
    """

    def __init__(
        self, caches: Caches, intake: Intake, in_step: InStep | None, stopping: threading.Event
    ) -> None:
        """Nothing more is handed on once all is `stopping`."""
        self._caches = caches
        self._intake = intake
        self._in_step = in_step
        self._stopping = stopping

    def catch_up(self, robot: RobotHold, *, patient: bool) -> None:
        """Ask, and hand on what is held, until nothing is missing and nothing is held.

        One that does not answer is left to those that are `patient`.
        """
        if robot.fails:
            self._stopping.wait(PAUSES[robot.fails - 1])
        while not self._stopping.is_set():
            robot.again, began = False, time.monotonic()
            progress, whole = self._hand_on_backlog(robot, final=robot.fails == ASKS - 1)
            if self._stopping.is_set():
                return
            if not whole and (progress or robot.fails < ASKS - 1):
                robot.again = True  # it stays held, whether or not anything has come that is
            gap, handed_on = self.drain(robot)
            if self._stopping.is_set():
                return
            if not progress and ((gap and not handed_on) or not whole):
                now = time.monotonic()
                if robot.caches.may_come_back(now) or robot.caches.may_answer(now):
                    robot.fails = 0
                    self._stopping.wait(PAUSES[0])
                    return  # it stays held, and is asked anew after others
                robot.fails += 1
                if robot.fails < ASKS:
                    if robot.caches.unanswered and not patient:
                        return
                    self._stopping.wait(PAUSES[robot.fails - 1])
                    continue
                self.drain(robot, began)
            robot.fails = 0
            if not robot.is_held:
                return

    def drain(self, robot: RobotHold, until: float | None = None) -> tuple[bool, bool]:
        """Hand on what is held; whether a gap has ended it, and whether anything was handed on."""
        patient = time.monotonic() + PATIENCE
        return robot.drain(lambda: self._turn(robot, robot.held_stamp, patient), until)

    def _hand_on_backlog(self, robot: RobotHold, *, final: bool) -> tuple[bool, bool]:
        """Hand on what the robot's caches keep; whether anything was new, and whether it is all of it.

        `final`: it is asked no more.
        """
        progress, whole, robot.caches.answered = False, True, None
        try:
            with closing(Backlog(self._caches, robot.name, robot.sources.wanted)) as backlog:
                whole = final or not robot.sources.lacks_any(backlog.sources, backlog.runs)
                for message, follows in backlog.messages() if whole else ():
                    stamp = None if message.head is None else message.head[0]
                    turn = partial(self._turn, robot, stamp)
                    progress |= robot.take_cached(message, time.monotonic(), turn, follows=follows or final)
                    if self._stopping.is_set():
                        return progress, False
                if whole:
                    robot.caches.answered = {source.sensor for source in backlog.sources}
            robot.caches.note_answered(True, time.monotonic())
        except Unanswered:
            whole = False
            robot.caches.note_answered(False, time.monotonic())
        return progress, whole

    def _turn(self, robot: RobotHold, stamp: int | None, until: float = math.inf) -> bool:
        """Wait until a message of that stamp has its turn among other robots', and then as `_room` does."""
        if self._in_step is not None and stamp is not None:
            self._in_step.wait(robot.name, stamp, self._stopping)
        return self._room(robot, until)

    def _room(self, robot: RobotHold, until: float = math.inf) -> bool:
        """Wait until the queue has room for a message that is resumed; False: the mapper stops.

        After `until`, s, there is room for any: the queue drops what is too much.
        """
        while not self._stopping.is_set():
            if self._intake.has_room(robot.name, SHARE) or time.monotonic() > until:
                return True
            self._stopping.wait(_PAUSE)
        return False
