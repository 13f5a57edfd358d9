"""Poses of one robot: which run of a publisher owns them, and where the robot's time begins anew.

A robot's poses come from one publisher, in the order in which it sent them, with stamps that rise. Where
that is not so, a clock was set back, a publisher was restarted, two publishers share one name, or a pose is
wrong: what can be believed then is decided here, pose by pose, so that no scan is placed between two poses
that do not belong together.
"""

import math
from collections import deque
from typing import NamedTuple

from ogm_core.placing.pose_history import PoseHistory, nearly_equal, shorter_arc
from ogm_core.placing.receipts import PoseNote
from ogm_core.placing.rules import JITTER_NS, PlacingRules, remember
from ogm_core.types import Pose, PoseStamped

LATE_IN_A_ROW = 5
"""So many late poses in a row, each later than the one before, are a clock that went back."""
_RECENT = 5
"""More than one outlier among so many poses: two publishers?"""


class Verdict(NamedTuple):
    """What becomes of a pose."""

    taken: bool
    """Whether it is believed: scans that wait may be placed now."""
    began: str | None = None
    """Why a new history has begun, in words that end the sentence "it waited when ..."; None if none has."""
    new_owner: bool = False
    """Whether that is because another run owns the robot now."""
    note: PoseNote | None = None
    """What to count it as, beside received."""
    kind: str = ""
    """Which kind of trouble `said` is about; "" if there is none."""
    said: str = ""
    """What a user should know."""


_BELIEVED = Verdict(True)


class RobotPoses:
    """The history of one robot's poses, and what decides whether a pose belongs to it."""

    def __init__(self, rules: PlacingRules) -> None:
        self._rules = rules
        self.owner: str | None = None
        """The run whose poses count; None before the first pose."""
        self.replaced: list[str] = []
        """Runs that owned the robot before, the one heard last at the end."""
        self.histories = 0
        """How many histories have begun."""
        self._history = PoseHistory()
        self._provisional: tuple[int, Pose] | None = None
        """A pose that no robot reaches from the one before it, until the next pose tells which one was "
        "wrong."""
        self._doubted = False
        """Whether the provisional pose's stamp is ambiguous."""
        self._last_seq = 0
        self._late: list[int] = []
        """Stamps of the late poses in a row."""
        self._outliers: deque[bool] = deque(maxlen=_RECENT)

    @property
    def history(self) -> PoseHistory:
        """The poses that scans are placed by."""
        return self._history

    @property
    def newest(self) -> int | None:
        """Stamp of the newest pose, ns, be it provisional; None before the first."""
        return self._history.newest if self._provisional is None else self._provisional[0]

    def add(self, message: PoseStamped, *, anew: bool, released: bool) -> Verdict:
        """Judge a pose, and keep it if it is believed.

        `anew`: the clock of one of the robot's sensors went back, so a new history begins with the next pose.
        `released`: whether the owner is known to be gone, so that a run that it has replaced may own again.
        """
        if message.run != self.owner:
            if message.run in self.replaced and not released:
                remember(self.replaced, message.run)
                return Verdict(False, note="superseded", kind="superseded", said=self._replaced(message.run))
            return self._change_owner(message)
        newest = self.newest
        assert newest is not None  # an owner has sent a pose
        if message.stamp < newest:
            return self._earlier(message, newest)
        if message.stamp == newest:
            return self._again(message, anew)
        self._late.clear()
        self._last_seq = message.seq
        if anew:
            return self._begin(message, "the clock of one of its sensors had gone back")
        return self._later(message)

    def _later(self, message: PoseStamped) -> Verdict:
        """The rules of a pose that is later than the newest one."""
        stamp, pose, history = message.stamp, message.pose, self._history
        assert history.newest is not None
        from_before = self._rules.reachable(stamp - history.newest, history.newest_pose, pose)
        if self._provisional is None:
            self._outliers.append(False)
            if from_before:
                history.append(stamp, pose)
                return _BELIEVED
            self._provisional, self._doubted = (stamp, pose), False
            return _BELIEVED
        odd_stamp, odd = self._provisional
        from_odd = self._rules.reachable(stamp - odd_stamp, odd, pose)
        how = _jump(history.newest, history.newest_pose, odd_stamp, odd)
        if from_odd and from_before:
            return self._begin(
                message, f"its poses had jumped ({how})", kind="jump", said=_JUMPED.format(how)
            )
        if from_odd:
            return self._begin(
                message, f"its poses had jumped ({how})", kind="jump", said=_JUMPED.format(how), keep=True
            )
        self._outliers.append(True)
        if from_before:
            self._history.append(stamp, pose)
            self._provisional = None
        else:
            self._provisional, self._doubted = (stamp, pose), False
        return Verdict(True, note="outlier", kind="outlier", said=self._wrong(how))

    def _earlier(self, message: PoseStamped, newest: int) -> Verdict:
        """The rules of a pose that is earlier than the newest one."""
        back = (newest - message.stamp) / 1e9
        numbered = message.run != "" and not message.seq == self._last_seq == 0
        went_back = newest - message.stamp > JITTER_NS and (not numbered or message.seq > self._last_seq)
        if not went_back:
            if self._late and message.stamp <= self._late[-1]:
                self._late.clear()
            self._late.append(message.stamp)
            if len(self._late) < LATE_IN_A_ROW:
                said = f"a pose is {back:g} s earlier than the one before it, and is not used"
                return Verdict(False, note="late", kind="late", said=said)
        self._last_seq = message.seq
        said = (
            f"the clock of its poses went back by {back:g} s: a new history of poses begins, scans of the "
            "time before are placed no more. If no clock was set and no simulation restarted, give each "
            "publisher a name of its own"
        )
        return self._begin(message, "the clock of its poses had gone back", "restarted", "restarted", said)

    def _again(self, message: PoseStamped, anew: bool) -> Verdict:
        """The rules of a pose that has the stamp of the newest one."""
        newest = self._history.newest_pose if self._provisional is None else self._provisional[1]
        if nearly_equal(newest, message.pose):
            return Verdict(False, note="late", kind="late", said="a pose has the stamp of the one before it")
        self._last_seq = message.seq
        if anew:
            return self._begin(message, "the clock of one of its sensors had gone back")
        if self._provisional is None:
            self._history.doubt(message.stamp)
        else:
            self._doubted = True
        said = (
            f"two different poses have the stamp {message.stamp}, so no scan is placed beside them: stamps "
            "repeat. Give every pose the time at which it was true, in ns (are they whole seconds, or "
            "never set?)"
        )
        return Verdict(True, note="ambiguous", kind="ambiguous", said=said)

    def _change_owner(self, message: PoseStamped) -> Verdict:
        if message.run in self.replaced:
            self.replaced.remove(message.run)
        if self.owner is not None:
            remember(self.replaced, self.owner)
        self.owner, self._last_seq = message.run, message.seq
        return self._begin(message, "another run of its publisher began")._replace(new_owner=True)

    def _begin(
        self,
        message: PoseStamped,
        began: str,
        note: PoseNote | None = None,
        kind: str = "",
        said: str = "",
        *,
        keep: bool = False,
    ) -> Verdict:
        """Begin a new history with a pose; `keep`: with the provisional one before it."""
        self._history = PoseHistory(self._rules.pose_gap * 1e9)
        if keep and self._provisional is not None:
            self._history.append(*self._provisional)
            if self._doubted:
                self._history.doubt(self._provisional[0])
        self._history.append(message.stamp, message.pose)
        self._provisional = None
        self._late.clear()
        self._outliers.clear()
        self.histories += 1
        return Verdict(True, began, note=note, kind=kind, said=said)

    def _replaced(self, run: str) -> str:
        return (
            f"poses of run {run!r} are refused, because run {self.owner!r} has replaced it: two publishers "
            "under one name? Give every robot a name of its own"
        )

    def _wrong(self, how: str) -> str:
        if sum(self._outliers) > 1:
            return f"poses contradict each other ({how}): {_TWO}"
        return f"a pose is dropped, no robot gets there ({how}; see mapper.max_speed, mapper.max_turn_rate)"


_TWO = "two publishers under one name? Give every robot a name of its own"
_JUMPED = (
    "its poses jumped ({}), farther than mapper.max_speed and mapper.max_turn_rate allow: a new history "
    "of poses begins. If that was no correction of its localisation, raise them"
)


def _jump(t0: int, p0: Pose, t1: int, p1: Pose) -> str:
    far, turn = math.hypot(p1.x - p0.x, p1.y - p0.y), abs(shorter_arc(p0.theta, p1.theta))
    return f"{far:.3g} m and {turn:.3g} rad within {(t1 - t0) / 1e9:.3g} s"
