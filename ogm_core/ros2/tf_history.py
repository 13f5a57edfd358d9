"""One edge of a tf tree: where a frame is in its parent, over time."""

from array import array
from bisect import bisect_left, bisect_right
from struct import Struct

from ogm_core.errors import NoTransform, NoTransformYet
from ogm_core.ros2.transform import Transform

SPAN_NS = 30_000_000_000
"""Older samples are forgotten; one that is older still tells that the clock went back, ns."""
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

    __slots__ = ("_floats", "_stamps", "_start", "parent", "static")

    def __init__(self, parent: str, *, static: bool) -> None:
        self.parent = parent
        self.static = static
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
        it lies so far back that the clock must have been set; all before is forgotten.
        """
        stamps = self._stamps
        if self.static:
            self._forget()
        elif stamps and stamp <= (newest := stamps[-1]):
            if stamp < newest - SPAN_NS:
                self._forget()
                self._append(stamp, transform)
                return "restarted"
            n = bisect_left(stamps, stamp, self._start)
            if stamps[n] == stamp:
                return "repeated"
            stamps.insert(n, stamp)
            self._floats[n * _FLOATS : n * _FLOATS] = array("d", transform)
            self._bound()
            return "reordered"
        self._append(stamp, transform)
        return None

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
