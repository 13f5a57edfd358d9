"""Pasted tiles: what copies hold whose tiles come from elsewhere, and what they share."""

import numpy as np
import pytest

from ogm_core.cells.log_odds import PLANE
from ogm_core.cells.model import Plane
from ogm_core.lattice import CellRect
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.tiles.pasting import differing, no_tiles, pasted, without
from ogm_core.tiles.store import TILE
from ogm_core.tiles.view import TileView

PLANES = (Plane(PLANE, np.dtype(np.int16)),)


def cells_of(copies, rect):
    return TileView(copies, rect, PLANES).planes()[PLANE]


def drawn(tiles, rect):
    """What tiles, by place, look like, by the slow way."""
    cells = np.zeros((rect.height, rect.width), np.int16)
    for (tx, ty), tile in tiles.items():
        y, x = ty * TILE - rect.iy, tx * TILE - rect.ix
        cells[y : y + TILE, x : x + TILE] = tile.reshape(TILE, TILE)
    return cells


def test_copies_hold_what_was_pasted_last_and_earlier_ones_do_not_change():
    rng, copies, tiles, kept = np.random.default_rng(0), no_tiles(), {}, []
    rect = CellRect(-7 * TILE, -7 * TILE, 14 * TILE, 14 * TILE)
    for revision in range(1, 80):
        places = np.unique(rng.integers(-7, 7, (rng.integers(1, 30), 2)), axis=0)
        new = rng.integers(1, 30_000, (len(places), TILE * TILE)).astype(np.int16)
        copies = pasted(copies, places, {PLANE: new.copy()}, revision)
        tiles |= {(int(x), int(y)): tile for (x, y), tile in zip(places, new, strict=True)}
        kept.append((copies, drawn(tiles, rect)))
        changed = ChangedTiles.since(copies, revision - 1)
        assert {tuple(place) for place in changed.places.tolist()} == {tuple(p) for p in places.tolist()}
        assert sum(block.used for block in copies.blocks) == len(tiles)
    for copies, expected in kept:
        assert np.array_equal(cells_of(copies, rect), expected)
    # Blocks of which little is in use are given up.
    assert kept[-1][0].nbytes < 4 * len(tiles) * TILE * TILE * 2


def test_what_is_pasted_whole_is_not_copied():
    places, cells = np.array([[0, 0], [3, -2]]), np.ones((2, TILE * TILE), np.int16)
    copies = pasted(no_tiles(), places, {PLANE: cells}, 1)
    assert np.shares_memory(copies.blocks[0].planes[PLANE], cells)
    with pytest.raises(ValueError, match="read-only"):
        cells[0, 0] = 2


def test_differing_tiles_are_those_with_other_bits_or_none():
    places = np.array([[0, 0], [1, 0], [5, 5]])
    cells = np.ones((3, TILE * TILE), np.int16)
    copies = pasted(no_tiles(), places[:2], {PLANE: cells[:2].copy()}, 1)
    other = cells.copy()
    other[1, 77] = 3
    assert differing(copies, places, {PLANE: other}).tolist() == [False, True, True]
    zero = np.zeros((1, TILE * TILE))
    signed = pasted(no_tiles(), places[:1], {"x": zero.copy()}, 1)
    assert differing(signed, places[:1], {"x": -zero}).tolist() == [True]


def test_tiles_that_are_taken_away_read_as_never_written():
    places, cells = np.array([[0, 0], [1, 0]]), np.ones((2, TILE * TILE), np.int16)
    copies = pasted(no_tiles(), places, {PLANE: cells}, 1)
    left = without(copies, np.array([[True], [False]]))
    shown = cells_of(left, CellRect(0, 0, 2 * TILE, TILE))
    assert not shown[:, :TILE].any()
    assert shown[:, TILE:].all()
    assert left.lineage is not copies.lineage
    assert len(ChangedTiles.since(left, 0)) == 1
    again = pasted(left, places[:1], {PLANE: 2 * cells[:1]}, 2)
    assert (cells_of(again, CellRect(0, 0, TILE, TILE)) == 2).all()
    assert sum(block.used for block in again.blocks) == 2
