"""`python tests/update_vectors.py`: writes the examples of map updates that docs/protocol.md names.

Messages in the order in which a program hears them, what it is to do with each, and which copy of the map it
has then: for programs in other languages. Tests ask whether the file says what `made` gives.
"""

import base64
import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ogm_core.cells.log_odds import LogOdds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.types import Pose, Scan
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import encode_update

FILE = Path(__file__).parent / "data" / "tiles" / "map_updates.json"
ABOUT = (
    "Map updates in the order in which they are heard, each as base64 of its MessagePack. `do`: what a copy "
    "of the map does with it: apply, ignore (it is known), wait (for the other parts), or ask (something is "
    "missing; the next message is the answer). `copy`: what it is then: which map, the cells that it serves, "
    "[tx, ty, SHA-256 of the bytes of each plane] of every tile, and the log odds of some cells, "
    "[ix, iy, value], null where unknown. See docs/protocol.md, Follow the map."
)
STAMP = 1_700_000_000_000_000_000
BEAMS = 90


class Truth:
    """A map that grows scan by scan, and what its mapper says of it."""

    def __init__(self, cells, epoch, run):
        settings = GridSettings(resolution=0.5, cell_model=LogOdds(cells))
        self.grid = OccupancyGrid(settings, epoch, run)

    def scan(self, x, y, radius):
        """A scan from a point in a round room."""
        ranges = np.full(BEAMS, radius, np.float32)
        stamp = STAMP + (self.grid.revision + 1) * 10**9
        scan = Scan(stamp, -math.pi, math.tau / BEAMS, 0.1, 30.0, ranges)
        self.grid.integrate(scan, Pose(x, y, 0.25))

    def message(self, since=None):
        """What brings a copy at revision `since`, or any copy, to the map of now: an update."""
        snapshot = self.grid.snapshot()
        changed = ChangedTiles.since(snapshot.stored.tiles, since or 0)
        (update,) = updates_of(snapshot, changed, since or 0, whole=since is None)
        return update

    def copy(self):
        """What a copy of it is."""
        snapshot = self.grid.snapshot()
        tiles = self.message()
        log_odds = [
            [ix, iy, self.log_odds_at(snapshot, ix, iy)]
            for ix, iy in ((0, 0), (3, 2), (12, 0), (-11, 1), (-70, -3), (500, 500))
        ]
        return {
            "epoch": snapshot.epoch,
            "run": snapshot.run,
            "revision": snapshot.revision,
            "extent_cells": list(snapshot.rect),
            "tiles": [
                [tx, ty, {name: sha256(cells[row]) for name, cells in tiles.cells.items()}]
                for row, (tx, ty) in enumerate(tiles.tiles.tolist())
            ],
            "log_odds": log_odds,
        }

    @staticmethod
    def log_odds_at(snapshot, ix, iy):
        """The log odds of a cell, None where unknown; in float64, before map.npz rounds it."""
        rect = snapshot.rect
        if not (rect.ix <= ix < rect.ix + rect.width and rect.iy <= iy < rect.iy + rect.height):
            return None
        rows, columns = slice(iy - rect.iy, iy - rect.iy + 1), slice(ix - rect.ix, ix - rect.ix + 1)
        known = snapshot.published(rows, columns)[1][0, 0]
        return float(snapshot.log_odds(rows, columns)[0, 0]) if known else None


def sha256(cells):
    """Of numbers in little-endian byte order."""
    return hashlib.sha256(cells.astype(cells.dtype.newbyteorder("<")).tobytes()).hexdigest()


def made():
    """Each step: what happens, the update, what to do with it, and the copy that is there then, or None."""
    map_ = Truth("int16", "e1", "r1")
    map_.scan(0.1, 0.2, 6.0)
    early = map_.message(0)
    yield "a change is heard before the map was asked for", replace(early, prev=1, revision=1), "ask", None
    yield "the whole map is the answer", map_.message(), "apply", map_.copy()
    map_.scan(1.0, 0.2, 5.0)
    second, at_2 = map_.message(1), map_.copy()
    yield "a scan has changed some tiles", second, "apply", at_2
    yield "the same message again", second, "ignore", at_2
    yield "nothing has changed for a second", map_.message(2), "ignore", at_2
    map_.scan(-30.0, -2.0, 7.0)
    map_.scan(-31.0, -2.0, 7.0)
    yield "a message was lost", map_.message(3), "ask", at_2
    yield (
        "the answer to since=e1-r1-2: the map has grown to the west and south",
        map_.message(2),
        "apply",
        map_.copy(),
    )
    at_4 = map_.copy()
    map_.scan(12.0, 1.0, 25.0)
    one, other = halves(map_.message(4))
    yield "a large change comes in two parts", one, "wait", at_4
    yield "the second part", other, "apply", map_.copy()
    map_.grid.reset("e2")
    yield "the map is reset", map_.message(), "apply", map_.copy()
    exact = Truth("float64", "e3", "r2")
    exact.scan(0.1, 0.2, 6.0)
    unheard = exact.message(0)
    yield (
        "another mapper, whose cells are float64, tells of a change",
        replace(unheard, prev=1),
        "ask",
        map_.copy(),
    )
    yield "the whole of its map", exact.message(), "apply", exact.copy()


def halves(update):
    """An update in two parts."""
    middle = len(update.tiles) // 2
    for part, rows in enumerate((slice(0, middle), slice(middle, None))):
        cells = {name: plane[rows] for name, plane in update.cells.items()}
        yield replace(update, tiles=update.tiles[rows], cells=cells, part=part, parts=2)


def main():
    steps = [
        {"what": what, "message": base64.b64encode(encode_update(update)).decode(), "do": do, "copy": copy}
        for what, update, do, copy in made()
    ]
    lines = ",\n".join(f"  {json.dumps(step)}" for step in steps)
    FILE.write_text(f'{{\n "about": {json.dumps(ABOUT)},\n "steps": [\n{lines}\n ]\n}}\n')
    print(FILE)


if __name__ == "__main__":
    main()
