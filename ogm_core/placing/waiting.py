"""Scans that wait for their robot's poses, in order of arrival, and the memory that they hold."""

import math
from bisect import insort
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from operator import attrgetter

from ogm_core.placing.held import Held
from ogm_core.types import Scan


@dataclass(frozen=True)
class WaitingLimits:
    """How many scans may wait: by the bytes of all robots' scans, and by the cells of one robot's.

    `cells_of`: of how many cells a scan may speak. One pose can make all of a robot's scans ready at once.
    """

    nbytes: float = math.inf
    cells: float = math.inf
    cells_of: Callable[[Scan], float] = lambda _: 0.0


NO_LIMITS = WaitingLimits()


@dataclass(frozen=True, slots=True, eq=False)
class Waiting:
    """A scan that waits for its pose."""

    sensor: str
    scan: Scan
    number: int
    """Of the message, counted over all robots."""
    handed: float
    """When it came, s."""
    cells: float
    """Of how many cells it may speak."""

    @property
    def nbytes(self) -> int:
        """What it holds."""
        return self.scan.nbytes


class WaitingScans:
    """Those of one robot. Its bytes are counted here, and in what all robots hold; its cells here."""

    def __init__(self, of_all: Held) -> None:
        self._held = Held(of_all)
        self._items: list[Waiting] = []
        self.cells = 0.0

    def __len__(self) -> int:
        return len(self._items)

    def __iter__(self) -> Iterator[Waiting]:
        return iter(self._items)

    @property
    def nbytes(self) -> int:
        """What they hold."""
        return self._held.nbytes

    @property
    def first(self) -> Waiting:
        """The one that came first; there must be one."""
        return self._items[0]

    def copy(self) -> list[Waiting]:
        """Those that wait at this moment; any thread may ask."""
        return self._items.copy()

    def append(self, item: Waiting) -> None:
        """Let a scan wait, after those whose messages came before its own."""
        if self._items and item.number < self._items[-1].number:
            insort(self._items, item, key=attrgetter("number"))
        else:
            self._items.append(item)
        self._count(1, [item])

    def take(self, which: Callable[[Waiting], bool] = lambda _: True) -> list[Waiting]:
        """Take out those that `which` chooses."""
        taken = [item for item in self._items if which(item)]
        if taken:
            gone = {item.number for item in taken}
            self._items = [item for item in self._items if item.number not in gone]
            self._count(-1, taken)
        return taken

    def take_first(self) -> Waiting:
        """Take out the one that came first; there must be one."""
        item = self._items.pop(0)
        self._count(-1, [item])
        return item

    def _count(self, sign: int, items: list[Waiting]) -> None:
        self._held.add(sign * sum(item.nbytes for item in items))
        self.cells += sign * sum(item.cells for item in items)
        if not self._items:  # else what is lost in rounding would add up
            self.cells = 0.0
