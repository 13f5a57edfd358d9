"""Maps that are stored, and the fingerprints of all their states: no wrong one is taken for a right one."""

import hashlib
import json
from dataclasses import replace

import pytest

from counts_model import Counts, scans
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.grid_settings import GridSettings
from ogm_core.separate_grid import grid_of as map_of

RUN = "run1"
MODELS = pytest.mark.parametrize(
    "model", [LogOdds(), LogOdds("float64"), Counts(), Rate()], ids=["int16", "float64", "counts", "rate"]
)
"""Every cell model and type that a map may have."""


def grid_of(model=None, epoch="epoch1", **changes):
    """A map without scans, 5 cm a cell unless `changes` say otherwise."""
    return map_of(GridSettings(**{"cell_model": model or LogOdds(), **changes}), epoch)


def fingerprint(grid, placing=None, *, epoch=True):
    """Of all that is told of a map, its writer's run aside, and of its cells; and of a placing state."""
    snapshot = grid.snapshot()
    told = {**snapshot.meta(), "run": "", "updates": grid.cell_updates, "bytes": grid.nbytes}
    told["time"] = grid.time
    told["robots"] = list(getattr(grid, "robots", ()))
    if not epoch:
        del told["epoch"]
    digest = hashlib.sha256(json.dumps(told).encode())
    for name, cells in sorted(snapshot.stored.planes().items()):
        digest.update(f"{name} {cells.dtype} {cells.shape}".encode())
        digest.update(cells.tobytes())
    for key, value in sorted((placing or {}).items()):
        digest.update(key.encode() + b"\0" + value)
    return digest.hexdigest()


class Story:
    """A map that is stored now and then: every state that ever was, by its fingerprint."""

    def __init__(self, store, grid, *, robots=3):
        self.store, self.grid = store, grid
        self.placing = {f"robot{n}": b"nothing yet" for n in range(robots)}
        self._changed = dict(self.placing)
        self.states = {}
        """Those that were stored: the revision by the fingerprint."""
        self._scans = iter(())

    @classmethod
    def going_on(cls, store, found):
        """The story of a map that was restored."""
        story = cls(store, found.grid)
        story.placing, story._changed = dict(found.placing), {}
        return story

    def integrate(self, count=1):
        """Scans of one robot after another, round and round; its placing state changes with each.

        In a map that forgets there is a second from one to the next.
        """
        for _ in range(count):
            scan = next(self._scans, None)
            if scan is None:
                self._scans = iter(scans())
                scan = next(self._scans)
            robot = f"robot{(self.grid.revision + 1) % len(self.placing)}"
            self.grid.integrate(*in_time(scan, self.grid), robot=robot)
            self.placing[robot] = self._changed[robot] = b"%d " % self.grid.revision * 200

    def commit(self):
        """Store what is not stored; if that fails it is stored by the next."""
        changed, self._changed = self._changed, {}
        self.store.commit(self.grid.checkpoint(), self.grid.settings, RUN, changed)
        self.states[self.now] = self.grid.revision

    @property
    def now(self):
        """The fingerprint of this moment's state."""
        return fingerprint(self.grid, self.placing)


def in_time(placed, grid):
    """A scan and its pose, a second after the one before if the map forgets."""
    scan, pose = placed
    if grid.settings.half_life is not None:
        scan = replace(scan, stamp=grid.revision * 10**9)
    return scan, pose


def saved(store, name, settings):
    """The map that is saved under a name."""
    with store.snapshots.opened(name) as snapshot:
        return snapshot.grid(settings)


def restored(store, settings):
    """The fingerprint of what a store holds."""
    found = store.restore(settings)
    return None if found is None else fingerprint(found.grid, found.placing)
