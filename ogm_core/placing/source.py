"""Scans of one sensor: which were seen already, of which run they are, and whether their clock goes back."""

from ogm_core.placing.held import Held
from ogm_core.placing.rules import JITTER_NS, MAX_WAITING_SCANS, WAITING_NS, remember
from ogm_core.placing.sequence import Sequence
from ogm_core.types import Scan

MAX_RUNS = 64
"""Runs whose seqs are remembered; the one heard longest ago is forgotten."""
REPEATS_IN_A_ROW = 10
"""So many duplicates whose stamps rise are new scans under old numbers."""
RUN_BYTES = 512
"""What a run takes besides the spans of its seqs, about: its name, its place, empty spans."""


class Source:
    """One sensor of one robot.

    `holds`: its scans wait for the robot's next pose that is believed, because until then nobody knows which
    time they are of.
    """

    def __init__(self, name: str = "", held: Held | None = None) -> None:
        """`held` counts what runs and their seqs take in memory."""
        self._held = Held() if held is None else held
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
        self._runs: dict[str, Sequence] = {}
        """By run, the one heard last at the end."""
        self._heard: str | None = None
        """The run that was numbered last."""
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
        known = self._runs.get(scan.run)
        return scan.run != "" and known is not None and scan.seq in known

    def repeats(self, scan: Scan) -> bool:
        """Note a duplicate; whether it is the tenth in a row whose stamps rise."""
        rises = scan.stamp > self._repeated
        self._repeats, self._repeated = self._repeats + 1 if rises else 1, scan.stamp
        return self._repeats == REPEATS_IN_A_ROW

    def number(self, scan: Scan) -> None:
        """Note the seq of a scan that is no duplicate."""
        self._repeats = 0
        run, sequence = scan.run, self._runs.get(scan.run)
        if sequence is None or run != self._heard:
            if sequence is None:
                sequence = Sequence(self._held)
                self._held.add(RUN_BYTES)
            self._runs.pop(run, None)
            self._runs[run] = sequence
            self._heard = run
            if len(self._runs) > MAX_RUNS:
                self._forget_first()
        if run != "":
            sequence.note(scan.seq)

    def forget_most(self) -> None:
        """Forget all runs but the one heard last, and of that one which seqs before the last are missing."""
        while len(self._runs) > 1:
            self._forget_first()
        for sequence in self._runs.values():
            sequence.close_gaps()

    def _forget_first(self) -> None:
        """Forget the run that was heard longest ago."""
        sequence = self._runs.pop(next(iter(self._runs)))
        self._held.add(-RUN_BYTES - sequence.nbytes)

    def take(self, scan: Scan, number: int, histories: int) -> int:
        """Note a scan that its robot's poses are to place; by how many ns its clock went back, else 0.

        `number` is the message's, `histories` how many histories of poses have begun. `number` comes after.
        """
        known = self._runs.get(scan.run)
        above = scan.run == "" or known is None or known.is_above(scan.seq)
        if self._runs and known is None:
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
