"""Seqs of one key's messages, by the runs of their publisher: which were taken, and which will never be."""

import threading
from collections.abc import Iterable
from typing import Any

from ogm_core.placing.held import Held
from ogm_core.placing.sequence import Sequence

MAX_RUNS = 64
"""Runs whose seqs are remembered; the one heard longest ago is forgotten."""
RUN_BYTES = 512
"""What a run takes besides the spans of its seqs, about: its name, its place, empty spans."""


class Runs:
    """The seqs of a key's runs, the run heard last at the end; run "" numbers nothing.

    One thread changes them, and asks without a lock; any thread may ask what has one.
    """

    __slots__ = ("_heard", "_held", "_lock", "_newest", "_runs")

    def __init__(self, held: Held | None = None) -> None:
        """`held` counts what they take in memory."""
        self._held = Held() if held is None else held
        self._runs: dict[str, Sequence] = {}
        self._heard: str | None = None
        """The run of which a message was taken last."""
        self._newest: Sequence | None = None
        """Its seqs."""
        self._lock = threading.Lock()

    def seen(self, run: str, seq: int) -> bool:
        """Whether a message was taken, or will never be; for the thread that changes them."""
        known = self._runs.get(run)
        return known is not None and run != "" and seq in known

    def has(self, run: str, seq: int) -> bool:
        """The same for any thread."""
        with self._lock:
            return self.seen(run, seq)

    def of(self, run: str) -> Sequence | None:
        """The seqs of a run of which a message was taken."""
        known = self._runs.get(run)
        return known if known is not None and known.taken else None

    def note(self, run: str, seq: int) -> None:
        """Note a message that is taken."""
        newest = self._newest
        if newest is not None and run == self._heard and (run == "" or newest.extend(seq)):
            return
        with self._lock:
            if newest is None or run != self._heard:
                self._newest = newest = self._put_last(run)
                newest.taken, self._heard = True, run
            if run != "":
                newest.note(seq)

    def skip(self, run: str, first: int, last: int) -> None:
        """Note that messages will never be taken; rules that look at the last one know nothing of them."""
        with self._lock:
            if run != "":
                (self._runs.get(run) or self._put_last(run)).skip(first, last)

    def up_to(self, run: str, undecided: Iterable[int]) -> int | None:
        """The highest seq up to which all are decided, from the first one known; None if none is.

        `undecided`: seqs that were taken, of which it is not decided yet what becomes of them.
        """
        with self._lock:
            known = self._runs.get(run)
            first, last = (None, None) if known is None else known.first_span
        if first is None or last is None:
            return None
        last = min([last, *(seq - 1 for seq in undecided if seq >= first)])
        return last if last >= first else None

    def forget_most(self) -> None:
        """Forget all runs but the one heard last, and of that one which seqs before the last are missing."""
        with self._lock:
            while len(self._runs) > 1:
                self._forget_first()
            for sequence in self._runs.values():
                sequence.close_gaps()

    def state(self) -> list[Any]:
        """All of it, as values that do not change any more."""
        return [self._heard, [(run, sequence.state()) for run, sequence in self._runs.items()]]

    def restore(self, state: list[Any]) -> None:
        """Go on from such a state."""
        self._heard, runs = state
        for run, told in runs:
            self._put_last(run).restore(told)
        self._newest = None if self._heard is None else self._runs[self._heard]

    def _put_last(self, run: str) -> Sequence:
        known = self._runs.pop(run, None)
        if known is None:
            known = Sequence(self._held)
            self._held.add(RUN_BYTES)
        self._runs[run] = known
        if len(self._runs) > MAX_RUNS:
            self._forget_first()
        return known

    def _forget_first(self) -> None:
        """Forget the run that was heard longest ago."""
        run = next(iter(self._runs))
        sequence = self._runs.pop(run)
        if run == self._heard:
            self._heard = self._newest = None
        self._held.add(-RUN_BYTES - sequence.nbytes)
