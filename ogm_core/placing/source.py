"""Scans of one sensor: which were seen already, of which run they are, and whether their clock goes back."""

from collections import Counter
from typing import Any

from ogm_core.placing.held import Held
from ogm_core.placing.rules import JITTER_NS, MAX_WAITING_SCANS, WAITING_NS, remember
from ogm_core.placing.runs import Runs
from ogm_core.types import Scan

REPEATS_IN_A_ROW = 10
"""So many duplicates whose stamps rise are new scans under old numbers."""


class Source:
    """One sensor of one robot.

    `holds`: its scans wait for the robot's next pose that is believed, because until then nobody knows which
    time they are of.
    """

    def __init__(self, name: str = "", held: Held | None = None) -> None:
        """`held` counts what runs and their seqs take in memory."""
        self.name = name
        """`<robot>/<sensor>`."""
        self.holds = False
        self.step_at: int | None = None
        """Number of the message with which its clock went back, if no new history has begun since."""
        self.waiting: tuple[int, int, int] | None = None
        """At most so many scans wait, and the smallest and largest of their stamps."""
        self.run: str | None = None
        self.replaced: list[str] = []
        """Runs whose scans came before those of `run`, the one heard last at the end."""
        self.runs = Runs(held)
        """Seqs of the scans that were taken, and of those that never will be."""
        self.outcomes: Counter[str] = Counter()
        """What became of them, and of other scans: those that are decided, since the map was made."""
        self.last: tuple[str, int] | None = None
        """Run and seq of the one that came last."""
        self._began = False
        """Whether a scan was ever taken."""
        self._newest: int | None = None
        """Largest stamp since its clock last went back or a new history began, ns."""
        self._history = 0
        """The history in which its newest scan came."""
        self._repeats = 0
        """Duplicates in a row whose stamps rise."""
        self._repeated = 0
        """Stamp of the last of them, ns."""

    def crowds(self, stamp: int) -> bool:
        """Note one more waiting scan; whether it is time to look if some have waited for too long.

        What is noted are bounds: scans that wait no more are not taken off.
        """
        count, oldest, newest = self.waiting or (0, stamp, stamp)
        self.waiting = count, oldest, newest = count + 1, min(oldest, stamp), max(newest, stamp)
        return count > MAX_WAITING_SCANS or newest - oldest > WAITING_NS

    def seen(self, scan: Scan) -> bool:
        """Whether a scan is a duplicate; run "" numbers nothing."""
        return self.runs.seen(scan.run, scan.seq)

    def repeats(self, scan: Scan) -> bool:
        """Note a duplicate; whether it is the tenth in a row whose stamps rise."""
        rises = scan.stamp > self._repeated
        self._repeats, self._repeated = self._repeats + 1 if rises else 1, scan.stamp
        return self._repeats == REPEATS_IN_A_ROW

    def number(self, scan: Scan) -> None:
        """Note the seq of a scan that is no duplicate."""
        self._repeats = 0
        self._began = True
        self.runs.note(scan.run, scan.seq)

    def take(self, scan: Scan, number: int, histories: int) -> int:
        """Note a scan that its robot's poses are to place; by how many ns its clock went back, else 0.

        `number` is the message's, `histories` how many histories of poses have begun. `number` comes after.
        """
        known = self.runs.of(scan.run)
        above = scan.run == "" or known is None or known.is_above(scan.seq)
        if self._began and known is None:
            self.holds = True
        if self.run is not None and scan.run != self.run:
            remember(self.replaced, self.run)
            if scan.run in self.replaced:
                self.replaced.remove(scan.run)
        self.run = scan.run
        same_history = self._history == histories
        back = 0
        if self._newest is not None and same_history and above and scan.stamp < self._newest - JITTER_NS:
            back = self._newest - scan.stamp
            self.holds, self.step_at, self._newest = True, number, scan.stamp
        elif self._newest is None or not same_history:
            self._newest = scan.stamp
        else:
            self._newest = max(self._newest, scan.stamp)
        self._history = histories
        return back

    def state(self) -> dict[str, Any]:
        """What decides where its scans go, as values that do not change any more.

        Whoever repeats itself is complained of anew, and how many wait is counted anew.
        """
        return {
            "holds": self.holds,
            "step_at": self.step_at,
            "run": self.run,
            "replaced": tuple(self.replaced),
            "began": self._began,
            "newest": self._newest,
            "history": self._history,
            "runs": self.runs.state(),
            "outcomes": dict(self.outcomes),
            "last": self.last,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from such a state."""
        self.holds, self.step_at, self.run = state["holds"], state["step_at"], state["run"]
        self.replaced = list(state["replaced"])
        self._began, self._newest, self._history = state["began"], state["newest"], state["history"]
        self.runs.restore(state["runs"])
        # An older program stores neither.
        self.outcomes.update(state.get("outcomes", {}))
        last = state.get("last")
        self.last = None if last is None else (last[0], last[1])
