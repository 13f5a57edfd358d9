"""Four shares of a map, each with its store, a router, and robots of which some see across the cuts.

Each is a process. In the end the parts that the shares answer with are put together, and held against the
map that the robots' scans make where nothing ever goes wrong.
"""

import threading
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ogm_client.session import NetworkConfig, open_session, resolve_listen
from ogm_core.grid import OccupancyGrid
from ogm_core.wire.keys import MapKeys
from ogm_services.settings.settings import Settings
from tests.gathering import gathered, grid_of, parts, tiles_of_grid
from tests.soak.drives import SIGHTS, uninterrupted_grid
from tests.soak.missed import SETTLED, TELLING, Outcome, within
from tests.soak.services import Mapper, Robots, Service

SHARES = range(4)
CUT = 51.2
"""At x and at y, m: robots whose number has a 5 stand 1.2 m from it, and see across."""


@dataclass(frozen=True)
class Cells:
    """What a map is made of, how far its robots see, and what has to be equal in the end."""

    flags: dict[str, object]
    sight: str
    in_any_order: bool = True
    """Whether cells do not depend on whose scans come first; else it is known or unknown that is compared."""

    @property
    def map_flags(self) -> dict[str, object]:
        """The section `map` of the settings."""
        return self.flags | {"reach": SIGHTS[self.sight].reach}

    @property
    def share_flags(self) -> dict[str, object]:
        """Flags of every share."""
        return self.map_flags | {"cuts_x": CUT, "cuts_y": CUT}


ALONE = Cells(TELLING, "near")
COUNTS = Cells({"cell_model": "rate"}, "far")
"""Robots that see each other's places, and a model whose counts commute."""
LOG_ODDS = Cells({}, "far", in_any_order=False)


@dataclass
class Fleet:
    """Four shares, their robots, and the router between them."""

    endpoint: str
    cells: Cells
    router: Service
    shares: list[Mapper]
    robots: Robots
    over: list[dict[int, int]] = field(default_factory=list)
    """Scans of each robot in runs that are over."""
    found: Outcome = field(default_factory=Outcome)
    paced: bool = False
    """Whether a Pacer slows the robots down."""

    @property
    def sent(self) -> int:
        """Scans that all robots of this run have published."""
        return sum(self.robots.sent().values())

    def wait_for(self, count: int) -> None:
        """Return once the robots of this run have published so many scans."""
        assert within(SETTLED, lambda: self.sent >= count), "the robots do not publish"

    def settled(self) -> Outcome:
        """Stop the robots, wait until every share has all, and compare."""
        runs = [*self.over, self.robots.stop()]
        self.found.hz = self.robots.hz if self.paced else None
        sent = {robot: [run[robot] for run in runs] for robot in runs[-1]}
        self.found.sent = sum(map(sum, sent.values()))
        within(SETTLED, lambda: all(has_all(share, self.found.sent) for share in self.shares))
        revisions = [share.status()["revision"] for share in self.shares]
        # Each share places every scan: one that has another number has missed one, or taken one twice.
        self.found.integrated = max(revisions, key=lambda revision: abs(revision - self.found.sent))
        whole = uninterrupted_grid(sent, self.robots.rate, self.cells.map_flags, self.cells.sight)
        self.found.wrong_cells = self._wrong(whole)
        for share in self.shares:
            share.end()
        self.found.counted = sum((share.counted for share in self.shares), Counter[str]())
        return self.found

    def _wrong(self, whole: OccupancyGrid) -> int:
        """Tiles that differ in any bit; or cells that are known in one map, and not in the other."""
        with open_session(NetworkConfig(connect=(self.endpoint,))) as session:
            keys = MapKeys("default")
            assert within(SETTLED, lambda: len(parts(session, keys)) == len(SHARES)), "one is silent"
            found = parts(session, keys)
        if self.cells.in_any_order:
            tiles, right = gathered(found), tiles_of_grid(whole)
            return sum(tiles.get(place) != right.get(place) for place in tiles.keys() | right.keys())
        settings = Settings.model_validate({"map": self.cells.map_flags})
        one, again = whole.snapshot(), grid_of(found, settings.grid_settings()).snapshot()
        if one.rect != again.rect:
            return max(one.rect.cells, again.rect.cells)
        (_, known), (_, known_again) = one.published(), again.published()
        return int(np.count_nonzero(known != known_again))


def has_all(share: Mapper, count: int) -> bool:
    """Whether a share has integrated so many scans, and none waits."""
    status = share.status()
    return status["revision"] >= count and not status["scans"]["pending"]


@contextmanager
def fleet_in(
    folder: Path, robots: Iterable[int], rate: float, *, cells: Cells = ALONE, starting: float = 0.0
) -> Iterator[Fleet]:
    """Have it run; the robots start one by one within so many seconds, and the first has begun."""
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    with ExitStack() as opening:
        router = opening.enter_context(Service("tests.soak.router", endpoint))
        flags = cells.share_flags
        shares = [Mapper(endpoint, folder / f"share{k}", "connect", flags | {"share": k}) for k in SHARES]
        for share in shares:
            opening.enter_context(share)
        for share in shares:
            share.wait_until_ready()
        driving = Robots(endpoint, robots, rate, within=starting, sight=cells.sight)
        fleet = Fleet(endpoint, cells, router, shares, opening.enter_context(driving))
        fleet.wait_for(1)
        yield fleet


class Pacer:
    """Slows all robots down evenly while a share has too much to do; a thread, until the context ends.

    A machine that cannot take what the robots publish takes it slower, and drops nothing.
    """

    LOOK = 0.25
    """So often, s."""
    MANY, FEW = 1600, 1200
    """Scans that wait in a share: of the 4096 that may, a quarter is what it takes out of caches."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        fleet.paced = True
        self._pace = 1.0
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def __enter__(self) -> "Pacer":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._stopping.wait(self.LOOK):
            waiting = max(share.waiting for share in self._fleet.shares)
            factor = 0.7 if waiting > self.MANY else 1.05 if waiting < self.FEW else 1.0
            pace = min(1.0, max(0.05, factor * self._pace))
            if pace != self._pace:
                self._pace = pace
                self._fleet.robots.go_at(pace)
