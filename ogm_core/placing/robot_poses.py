"""Poses of one robot: which run of a publisher owns them, and where the robot's time begins anew.

A robot's poses come from one publisher, in the order in which it sent them, with stamps that rise. Where
that is not so, a clock was set back, a publisher was restarted, two publishers share one name, or a pose is
wrong: what can be believed then is decided here, pose by pose, so that no scan is placed between two poses
that do not belong together.
"""

from collections import deque
from typing import Any, NamedTuple

from ogm_core.placing import reasons
from ogm_core.placing.held import Held
from ogm_core.placing.kept_poses import HistoryState
from ogm_core.placing.pose_history import PoseHistory, nearly_equal
from ogm_core.placing.reasons import Reason
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
    note: PoseNote | None = None
    """What to count it as, beside received."""
    reason: Reason | None = None
    """What a user should know; None if there is nothing."""
    began: str | None = None
    """Why a new history has begun with it, in words; None if none has."""
    new_owner: bool = False
    """Whether that is because another run owns the robot now."""


_BELIEVED = Verdict(True)


class RobotPoses:
    """The history of one robot's poses, and what decides whether a pose belongs to it."""

    def __init__(self, rules: PlacingRules, held: Held | None = None) -> None:
        """`held` counts what the history takes in memory."""
        self._rules = rules
        self._held = Held() if held is None else held
        self.owner: str | None = None
        """The run whose poses count; None before the first pose."""
        self.replaced: list[str] = []
        """Runs that owned the robot before, the one heard last at the end."""
        self.histories = 0
        """How many histories have begun."""
        self._history = PoseHistory(rules, self._held)
        self._provisional: tuple[int, Pose] | None = None
        """A pose where no robot gets from the one before it, until the next one tells which was wrong."""
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

    def add(self, message: PoseStamped, *, stepped: str, released: bool) -> Verdict:
        """Judge a pose, and keep it if it is believed.

        `stepped`: the sensor whose clock went back, so that a new history begins with the next pose; or "".
        `released`: whether the owner is known to be gone, so that a run that it has replaced may own again.
        """
        run, owner = message.run, self.owner
        if run != owner:
            if run in self.replaced and not released:
                remember(self.replaced, run)
                return Verdict(False, "superseded", reasons.superseded_pose(run, owner or ""))
            return self._change_owner(message)
        newest = self.newest
        assert newest is not None  # an owner has sent a pose
        if message.stamp < newest:
            return self._earlier(message, newest - message.stamp)
        if message.stamp == newest:
            return self._again(message, stepped)
        self._late.clear()
        self._last_seq = message.seq
        return self._begin(message, _clock_of(stepped)) if stepped else self._later(message)

    def _change_owner(self, message: PoseStamped) -> Verdict:
        if message.run in self.replaced:
            self.replaced.remove(message.run)
        if self.owner is not None:
            remember(self.replaced, self.owner)
        self.owner, self._last_seq = message.run, message.seq
        return self._begin(message, "another run began to publish them")._replace(new_owner=True)

    def _later(self, message: PoseStamped) -> Verdict:
        """The rules of a pose that is later than the newest one."""
        stamp, pose, history = message.stamp, message.pose, self._history
        assert history.newest is not None
        from_before = self._rules.reachable(stamp - history.newest, history.newest_pose, pose)
        if self._provisional is None:
            self._outliers.append(False)
            if from_before:
                history.append(stamp, pose)
            else:
                self._provisional, self._doubted = (stamp, pose), False
            return _BELIEVED
        odd_stamp, odd = self._provisional
        from_odd = self._rules.reachable(stamp - odd_stamp, odd, pose)
        way = reasons.way_between(history.newest, history.newest_pose, odd_stamp, odd)
        if from_odd:
            # From both: nobody knows which of the two was wrong.
            began = self._begin(message, f"its poses had jumped ({way})", keep=not from_before)
            return began._replace(reason=reasons.jumped(way))
        self._outliers.append(True)
        if from_before:
            history.append(stamp, pose)
            self._provisional = None
        else:
            self._provisional, self._doubted = (stamp, pose), False
        wrong = reasons.contradiction if sum(self._outliers) > 1 else reasons.outlier
        return Verdict(True, "outlier", wrong(way))

    def _earlier(self, message: PoseStamped, by_ns: int) -> Verdict:
        """The rules of a pose that is earlier than the newest one."""
        numbered = message.run != "" and not message.seq == self._last_seq == 0
        went_back = by_ns > JITTER_NS and (not numbered or message.seq > self._last_seq)
        if not went_back:
            if self._late and message.stamp <= self._late[-1]:
                self._late.clear()
            self._late.append(message.stamp)
            if len(self._late) < LATE_IN_A_ROW:
                return Verdict(False, "late", reasons.late(by_ns))
        self._last_seq = message.seq
        began = self._begin(message, "the clock of its poses had gone back")
        return began._replace(note="restarted", reason=reasons.clock_went_back(by_ns))

    def _again(self, message: PoseStamped, stepped: str) -> Verdict:
        """The rules of a pose that has the stamp of the newest one."""
        newest = self._history.newest_pose if self._provisional is None else self._provisional[1]
        if nearly_equal(newest, message.pose):
            return Verdict(False, "late", reasons.REPEATED_POSE)
        self._last_seq = message.seq
        if stepped:
            return self._begin(message, _clock_of(stepped))
        if self._provisional is None:
            self._history.doubt(message.stamp)
        else:
            self._doubted = True
        return Verdict(True, "ambiguous", reasons.ambiguous(message.stamp))

    def _begin(self, message: PoseStamped, why: str, *, keep: bool = False) -> Verdict:
        """Begin a new history with a pose; `keep`: with the provisional one before it."""
        self._held.add(-self._history.nbytes)
        self._history = PoseHistory(self._rules, self._held)
        if keep and self._provisional is not None:
            self._history.append(*self._provisional)
            if self._doubted:
                self._history.doubt(self._provisional[0])
        self._history.append(message.stamp, message.pose)
        self._provisional = None
        self._late.clear()
        self._outliers.clear()
        self.histories += 1
        return Verdict(True, began=why)

    def state(self) -> dict[str, Any]:
        """What decides what is believed, but for the history, as values that do not change any more."""
        return {
            "owner": self.owner,
            "replaced": tuple(self.replaced),
            "histories": self.histories,
            "provisional": self._provisional,
            "doubted": self._doubted,
            "last_seq": self._last_seq,
            "late": tuple(self._late),
            "outliers": tuple(self._outliers),
        }

    def restore(self, state: dict[str, Any], history: HistoryState) -> None:
        """Go on from such a state, and that of the history."""
        self.owner, self.histories, self._doubted = state["owner"], state["histories"], state["doubted"]
        self.replaced = list(state["replaced"])
        if state["provisional"] is not None:
            stamp, pose = state["provisional"]
            self._provisional = stamp, Pose(*pose)
        self._last_seq, self._late = state["last_seq"], list(state["late"])
        self._outliers.extend(state["outliers"])
        self._history.restore(history)


def _clock_of(sensor: str) -> str:
    return f"the clock of {sensor} had gone back"
