"""A map that is cut, put together of the parts that its shares answer with, by tile."""

import msgpack
import numpy as np
import zenoh

from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import TILE
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.wire.map_update import decode_updates


def parts(session, keys, parameters="", timeout=30.0):
    """By share: the messages of its one reply, and what is attached to that."""
    selector = f"{keys.share('*', 'part')}{'?' if parameters else ''}{parameters}"
    replies = session.get(
        selector, target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE, timeout=timeout
    )
    found = {}
    for reply in replies:
        assert reply.ok is not None, reply.err.payload.to_string()
        index = int(str(reply.ok.key_expr).split("/")[-2])
        assert index not in found, "a share answers with one reply"
        assert str(reply.ok.encoding) == "application/vnd.ogm.tiles"
        updates = list(decode_updates(reply.ok.payload.to_bytes()))
        found[index] = updates, msgpack.unpackb(reply.ok.attachment.to_bytes())
    return found


def tiles_of(updates):
    """The tiles of messages: their planes as bytes, by place."""
    return {
        tuple(place): tuple(update.cells[plane.name][n].tobytes() for plane in update.planes)
        for update in updates
        for n, place in enumerate(update.tiles.tolist())
    }


def gathered(found):
    """The tiles of all parts; none of them is in two."""
    tiles = {}
    for updates, _ in found.values():
        assert all(update.whole for update in updates)
        part = tiles_of(updates)
        assert not part.keys() & tiles.keys(), "a tile belongs to one share"
        tiles |= part
    return tiles


def tiles_of_grid(grid: OccupancyGrid):
    """The tiles of a whole map, likewise."""
    changed = ChangedTiles.since(grid.snapshot().stored.tiles, 0)
    planes = changed.planes()
    return {
        tuple(place): tuple(planes[plane.name][n].tobytes() for plane in grid.model.planes)
        for n, place in enumerate(changed.places.tolist())
    }


def grid_of(found, settings):
    """The parts of all shares as one whole map, of these settings."""
    tiles, (first, _) = gathered(found), next(iter(found.values()))
    left, bottom = (min(place[k] for place in tiles) for k in (0, 1))
    width, height = (1 + max(place[k] for place in tiles) - low for k, low in ((0, left), (1, bottom)))
    planes = {}
    for n, plane in enumerate(first[0].planes):
        side = TILE * plane.side
        cells = np.zeros((height * side, width * side), plane.dtype)
        for (tx, ty), parts_of_planes in tiles.items():
            row, column = (ty - bottom) * side, (tx - left) * side
            tile = np.frombuffer(parts_of_planes[n], plane.dtype).reshape(side, side)
            cells[row : row + side, column : column + side] = tile
        planes[plane.name] = cells
    grid = OccupancyGrid(settings, "gathered")
    grid.begin_with(planes, (TILE * left, TILE * bottom))
    return grid
