"""One edge of a tf tree: where a frame is in its parent, over time."""

from array import array
from bisect import bisect_left, bisect_right
from struct import Struct

from ogm_core.errors import NoTransform, NoTransformYet
from ogm_core.ros2.transform import Transform

SPAN_NS = 30_000_000_000
"""Older samples are forgotten; one that is older still tells that the clock went back, ns."""
LATE_IN_A_ROW = 5
"""So many samples in a row, each later than the one before, tell so, too, if all are LATE_NS old: a simulator
or a recording that begins again after a few seconds."""
LATE_NS = 1_000_000_000
"""No network brings samples so much out of order, ns."""
MAX_SAMPLES = 4096
"""So many are kept at most."""
_SAMPLE = Struct("7d")
_FLOATS = 7
_TRIM = 256
"""So many are dropped at once."""


class TfHistory:
    """The newest samples of one edge in the order of their stamps (ns), or the one of a static edge.

    Two samples of one stamp: the first stays, as something may have been told by it.
    """

    __slots__ = ("_floats", "_late", "_stamps", "_start", "parent", "restarts", "static")

    def __init__(self, parent: str, *, static: bool) -> None:
        self.parent = parent
        self.static = static
        self.restarts = 0
        """How often the clock went back."""
        self._late: list[tuple[int, Transform]] = []
        """Samples in a row that came long after a later one."""
        self._stamps = array("q")
        self._floats = array("d")
        self._start = 0

    def __len__(self) -> int:
        return len(self._stamps) - self._start

    @property
    def newest(self) -> int | None:
        """Stamp of the newest sample, ns."""
        return self._stamps[-1] if self._stamps else None

    def stamps_after(self, stamp: int | None) -> list[int]:
        """The stamps of the kept samples that are later, in order; all of them for None."""
        first = self._start if stamp is None else bisect_right(self._stamps, stamp, self._start)
        return self._stamps[first:].tolist()

    def add(self, stamp: int, transform: Transform) -> str | None:
        """Keep a sample; what is to be said of it, if it is no usual one.

        "reordered": there is a later one. "repeated": there is one of this stamp, which stays. "restarted":
        it, or LATE_IN_A_ROW of them, lie so that the clock must have been set; all before is forgotten.
        """
        stamps = self._stamps
        if self.static:
            self._forget()
        elif stamps and stamp < stamps[-1]:
            return self._earlier(stamp, transform)
        elif stamps and stamp == stamps[-1]:
            return "repeated"
        self._late.clear()
        self._append(stamp, transform)
        return None

    def restart(self) -> None:
        """Forget all, as the clock of what is told went back."""
        self._forget()
        self._late.clear()
        self.restarts += 1

    def at(self, stamp: int, gap_ns: float, hold_ns: float) -> Transform:
        """The transform at `stamp`; a static edge's is the same at all times.

        Between two samples that are at most `gap_ns` (or `hold_ns`) apart, or nearly equal, it is
        interpolated. Past a sample it holds for `hold_ns`: of an edge that changes seldom and little.

        Raises:
            NoTransformYet: the newest sample is older than that.
            NoTransform: `stamp` lies before the oldest, or in a gap.
        """
        stamps, start = self._stamps, self._start
        if self.static:
            return self._sample(start)
        after = bisect_left(stamps, stamp, start)
        if after == len(stamps):
            if after == start:
                raise NoTransformYet("no sample has come since the clock went back", "newest")
            if stamp - stamps[-1] <= hold_ns:
                return self._sample(after - 1)
            raise NoTransformYet(f"its newest sample is {(stamp - stamps[-1]) / 1e9:.3f} s older", "newest")
        if stamps[after] == stamp:
            return self._sample(after)
        if after == start:
            raise NoTransform(f"its oldest sample is {(stamps[start] - stamp) / 1e9:.3f} s newer", "oldest")
        before, between = after - 1, stamps[after] - stamps[after - 1]
        one, other = self._sample(before), self._sample(after)
        if between <= max(gap_ns, hold_ns) or one.near(other):
            return one.between(other, (stamp - stamps[before]) / between)
        if stamp - stamps[before] <= hold_ns:
            return one
        raise NoTransform(f"it has a gap of {between / 1e9:.3f} s then (pose_gap: {gap_ns / 1e9:g} s)", "gap")

    def _earlier(self, stamp: int, transform: Transform) -> str:
        """Keep a sample that there is a later one of."""
        stamps, late = self._stamps, self._late
        if stamp > stamps[-1] - LATE_NS or (late and stamp <= late[-1][0]):
            late.clear()
        if stamp <= stamps[-1] - LATE_NS:
            late.append((stamp, transform))
        if stamp < stamps[-1] - SPAN_NS or len(late) == LATE_IN_A_ROW:
            kept = late.copy()
            self.restart()
            for each in kept:
                self._append(*each)
            return "restarted"
        n = bisect_left(stamps, stamp, self._start)
        if stamps[n] == stamp:
            return "repeated"
        stamps.insert(n, stamp)
        self._floats[n * _FLOATS : n * _FLOATS] = array("d", transform)
        self._bound()
        return "reordered"

    def _sample(self, n: int) -> Transform:
        return Transform(*_SAMPLE.unpack_from(self._floats, n * _SAMPLE.size))

    def _append(self, stamp: int, transform: Transform) -> None:
        self._stamps.append(stamp)
        self._floats.extend(transform)
        self._bound()

    def _bound(self) -> None:
        stamps, start = self._stamps, self._start
        oldest, first_kept = stamps[-1] - SPAN_NS, len(stamps) - MAX_SAMPLES
        while stamps[start] < oldest or start < first_kept:
            start += 1
        if start >= _TRIM:
            del stamps[:start], self._floats[: start * _FLOATS]
            start = 0
        self._start = start

    def _forget(self) -> None:
        self._stamps, self._floats, self._start = array("q"), array("d"), 0
