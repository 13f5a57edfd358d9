"""Sequence numbers of the messages of one run: which were seen already."""

from array import array
from bisect import bisect_left, bisect_right
from typing import Any

from ogm_core.placing.held import Held

MAX_STEP = 1_000_000
"""A seq farther above the last is no gap: it may be a wrong one."""
STRAYS_IN_A_ROW = 5
"""So many of them in a row, rising, and the numbering goes on from there."""
MAX_SPANS = 1024
"""Gaps between the seqs seen are remembered up to this many; what comes for an older one is called seen."""
SPAN_BYTES = 16


class Sequence:
    """The seqs (below 2^63) of one run that were seen, as spans without a gap, and the last one."""

    __slots__ = ("_ends", "_held", "_starts", "_strays", "_told", "last", "taken")

    def __init__(self, held: Held | None = None) -> None:
        """`held` counts what its spans take in memory."""
        self._held = Held() if held is None else held
        self.last: int | None = None
        """The largest seq, but for strays; None before the first."""
        self.taken = False
        """Whether a message of the run was taken, and not all of them skipped."""
        self._starts = array("q")
        self._ends = array("q")
        """The first and the last seq of each span, rising."""
        self._strays: list[int] = []
        self._told: tuple[Any, ...] | None = None
        """The state that was told last, until it changes: whoever has it shares the arrays."""

    def __contains__(self, seq: int) -> bool:
        """Whether a seq was seen."""
        at = bisect_right(self._starts, seq) - 1
        return at >= 0 and seq <= self._ends[at]

    @property
    def nbytes(self) -> int:
        """What its spans take in memory."""
        return len(self._starts) * SPAN_BYTES

    @property
    def first_span(self) -> tuple[int | None, int | None]:
        """The first seq, and the last one before the first gap; None, None before the first."""
        return (self._starts[0], self._ends[0]) if self._starts else (None, None)

    def is_above(self, seq: int) -> bool:
        """Whether a seq is above the last one, as every seq is that stays 0, and the first of a run."""
        return self.last is None or seq > self.last or seq == self.last == 0

    def extend(self, seq: int) -> bool:
        """Take the seq after the last one for seen; False if that is more than to change one number."""
        last = self.last
        if (
            last is None
            or seq != last + 1
            or self._strays
            or self._told is not None
            or self._ends[-1] != last
        ):
            return False
        self._ends[-1] = self.last = seq
        return True

    def note(self, seq: int) -> None:
        """Take a seq for seen, unless it is a stray."""
        if self._told is not None:
            self._change()
        if self.last is not None and seq > self.last + MAX_STEP:
            self._note_stray(seq)
            return
        self._strays.clear()
        self.last = seq if self.last is None else max(self.last, seq)
        at = bisect_right(self._starts, seq) - 1
        if at >= 0 and seq <= self._ends[at]:
            return
        if at >= 0 and seq == self._ends[at] + 1:
            self._ends[at] = seq
        else:
            at += 1
            self._starts.insert(at, seq)
            self._ends.insert(at, seq)
            self._held.add(SPAN_BYTES)
        if at + 1 < len(self._starts) and self._starts[at + 1] == seq + 1:
            self._join(at)
        if len(self._starts) > MAX_SPANS:
            self._join(0)

    def skip(self, first: int, last: int) -> None:
        """Take the seqs from the first to the last for seen, but for strays; `last` stays as it is."""
        if self.last is not None and last > self.last + MAX_STEP:
            return
        self._change()
        low = bisect_left(self._ends, first - 1)
        high = bisect_right(self._starts, last + 1)
        if low < high:
            first, last = min(first, self._starts[low]), max(last, self._ends[high - 1])
        self._starts[low:high], self._ends[low:high] = array("q", [first]), array("q", [last])
        self._held.add((1 - (high - low)) * SPAN_BYTES)
        if len(self._starts) > MAX_SPANS:
            self._join(0)

    def close_gaps(self) -> None:
        """Take every seq between the first and the last for seen."""
        self._change()
        self._held.add(-self.nbytes)
        self._starts, self._ends = self._starts[:1], self._ends[-1:]
        self._held.add(self.nbytes)

    def state(self) -> tuple[Any, ...]:
        """All of it, as values that do not change any more: nothing is copied before it does."""
        if self._told is None:
            self._told = self.taken, self.last, self._starts, self._ends, tuple(self._strays)
        return self._told

    def restore(self, state: tuple[Any, ...]) -> None:
        """Go on from such a state."""
        self.taken, self.last, starts, ends, strays = state
        self._starts, self._ends, self._strays = array("q", starts), array("q", ends), list(strays)
        self._held.add(self.nbytes)

    def _change(self) -> None:
        if self._told is not None:
            self._told = None
            self._starts, self._ends = self._starts[:], self._ends[:]

    def _join(self, at: int) -> None:
        """Make one span of a span and the next one."""
        del self._starts[at + 1]
        del self._ends[at]
        self._held.add(-SPAN_BYTES)

    def _note_stray(self, seq: int) -> None:
        if self._strays and seq <= self._strays[-1]:
            self._strays.clear()
        self._strays.append(seq)
        if len(self._strays) == STRAYS_IN_A_ROW:
            strays, self._strays = self._strays, []
            self._held.add(-self.nbytes)
            self._starts, self._ends, self.last = array("q"), array("q"), None
            for stray in strays:
                self.last = stray  # however far apart they are
                self.note(stray)
