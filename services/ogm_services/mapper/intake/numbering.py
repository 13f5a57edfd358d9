"""Numbering of a source's messages: which seqs of which run were handed on, and what is missing."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto

from ogm_core.wire.heads import number_of, numbered_so

MAX_RUNS = 8
"""Runs of a source that are remembered, the one heard longest ago is forgotten."""
MAX_STEP = 1_000_000
"""A seq farther above the last is no gap: it may be a wrong one."""
STRAYS_IN_A_ROW = 5
"""So many of them in a row, rising, and the numbering goes on from there."""
MAX_TWINS = 4096
"""Messages out of a cache that may come by themselves, too: so many of a run are remembered."""


class Standing(Enum):
    """How a message stands to those of its source that were handed on before."""

    NEXT = auto()
    """Nothing is missing before it, as far as anybody can tell."""
    BEGINNING = auto()
    """The first one of its run that is heard, and not the run's first one."""
    GAP = auto()
    OLD = auto()
    """One of the same number was handed on, or given up."""
    STRAY = auto()
    """Too far above the last one to be a gap."""


@dataclass(slots=True)
class _Run:
    last: int | None
    """The largest seq that was handed on, but for strays; None before the first."""
    strays: list[int] = field(default_factory=list)
    twins: dict[int, int] = field(default_factory=dict)
    """Stamps, by seq, of messages that were handed on out of a cache."""


class Numbering:
    """The seqs of one source that were handed on, by run. A run "" numbers nothing.

    `decided_last` tells of a run how far it was decided in an earlier life of the mapper.
    """

    def __init__(self, decided_last: Callable[[str], int | None]) -> None:
        self._decided_last = decided_last
        self._runs: dict[str, _Run] = {}
        """The one heard last at the end."""
        self._heard: str | None = None
        self._expected = b""
        """The number that comes next in the run heard last, as it stands in a message; empty: any may."""
        self.unread = 0
        """Messages since the last numbered one whose number nobody could read: some of the missing."""

    def standing(self, run: str, seq: int) -> Standing:
        """How a message stands that is to be handed on."""
        if run == "":
            return Standing.NEXT
        last = self._of(run).last
        if last is None:
            return Standing.BEGINNING if seq > self.unread else Standing.NEXT
        if seq <= last:
            return Standing.OLD
        if seq > last + MAX_STEP:
            return Standing.STRAY
        return Standing.NEXT if seq - last - 1 <= self.unread else Standing.GAP

    def take_next(self, payload: bytes) -> bool:
        """Note a message if it is the next one of the run heard last, as nearly all are: told at a glance."""
        if not self._expected or not numbered_so(payload, self._expected):
            return False
        assert self._heard is not None
        known = self._runs[self._heard]
        assert known.last is not None
        known.last += 1
        self._expected, self.unread = number_of(known.last + 1, self._heard), 0
        return True

    def take(self, run: str, seq: int, *, twin: int | None = None) -> range:
        """Note a message that is handed on; return the seqs before it that are given up by that.

        `twin`: the stamp of one that comes out of a cache, and may come by itself, too.
        """
        if run == "":
            return range(0)
        known, unread = self._of(run), self.unread
        last, self.unread, self._expected = known.last, 0, b""
        if twin is not None:
            known.twins[seq] = twin
            if len(known.twins) > MAX_TWINS:
                del known.twins[next(iter(known.twins))]
        elif known.twins and (last is None or seq > last):
            known.twins.clear()  # what comes by itself comes in order
        if last is not None and seq > last + MAX_STEP:
            self._stray(known, seq)
            return range(0)
        known.strays.clear()
        known.last = seq if last is None else max(last, seq)
        if twin is None:
            self._expected = number_of(known.last + 1, run)
        return range(0) if last is None or seq <= last + 1 + unread else range(last + 1, seq)

    def begin_at(self, run: str, seq: int) -> range:
        """Note that what is missing before a message will not come; return the seqs that are given up."""
        known = self._of(run)
        last, known.last, self.unread, self._expected = known.last, seq - 1, 0, b""
        return range(0) if last is None else range(last + 1, seq)

    def is_twin(self, run: str, seq: int, stamp: int) -> bool:
        """Whether this very message was handed on out of a cache already."""
        known = self._runs.get(run)
        return known is not None and known.twins.get(seq) == stamp

    @property
    def begun(self) -> bool:
        """Whether anything was handed on of a run that has numbers, or decided in an earlier life."""
        return any(known.last is not None for known in self._runs.values())

    def has(self, run: str) -> bool:
        """Whether anything of that run was."""
        known = self._runs.get(run)
        return run != "" and (self._decided_last(run) if known is None else known.last) is not None

    def last(self, run: str) -> int | None:
        """The largest seq of a run that was handed on, or decided in an earlier life; None if none was."""
        return self._of(run).last

    def _of(self, run: str) -> _Run:
        if run == self._heard:
            return self._runs[run]
        known = self._runs.pop(run, None) or _Run(self._decided_last(run))
        self._runs[run], self._heard, self._expected = known, run, b""
        if len(self._runs) > MAX_RUNS:
            del self._runs[next(iter(self._runs))]
        return known

    @staticmethod
    def _stray(known: _Run, seq: int) -> None:
        if known.strays and seq <= known.strays[-1]:
            known.strays.clear()
        known.strays.append(seq)
        if len(known.strays) == STRAYS_IN_A_ROW:
            known.last = seq
            known.strays.clear()
