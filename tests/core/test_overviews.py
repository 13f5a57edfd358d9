"""Overviews of tiles against the definition, four pixels at a time."""

import itertools

import numpy as np
import pytest

import naive
from ogm_core.tiles.overviews import OVERVIEW_BYTES, make_overviews

EDGES = (0, 1, 50, 51, 166, 167, 255)


def overviews_of(tiles):
    found = np.full((len(tiles), OVERVIEW_BYTES), 77, np.uint8)
    make_overviews(np.concatenate(tiles, axis=1), found)
    return found


def naive_overviews(tile):
    levels = []
    while tile.shape != (1, 1):
        tile = naive.halved(tile)
        levels.append(tile.ravel())
    return np.concatenate(levels)


def tiles():
    rng = np.random.default_rng(3)
    blocks = np.array(list(itertools.product(EDGES, repeat=4)), np.uint8)
    for first in range(0, len(blocks), 1024):
        some = np.resize(blocks[first : first + 1024], (32, 32, 2, 2))
        yield f"blocks from {first} on", some.transpose(0, 2, 1, 3).reshape(64, 64)
    yield "random", rng.integers(0, 256, (64, 64)).astype(np.uint8)
    yield "little known", rng.choice(np.array([0] * 400 + [9, 120, 200], np.uint8), (64, 64))
    yield "no walls", rng.choice(np.array(EDGES[:-2], np.uint8), (64, 64))
    for byte in (0, 1, 166, 167, 255):
        yield f"all {byte}", np.full((64, 64), byte, np.uint8)


@pytest.mark.parametrize("tile", [pytest.param(tile, id=name) for name, tile in tiles()])
def test_a_tile(tile):
    assert overviews_of([tile])[0].tolist() == naive_overviews(tile).tolist()


def test_tiles_side_by_side_have_nothing_to_do_with_each_other():
    rng = np.random.default_rng(5)
    many = [rng.integers(0, 256, (64, 64)).astype(np.uint8) for _ in range(5)]
    assert np.array_equal(overviews_of(many), [naive_overviews(tile) for tile in many])
