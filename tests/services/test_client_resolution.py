"""The cells that a client asks for of a map that counts: by get_map, follow and watch alike."""

import asyncio

import numpy as np
import pytest

from ogm_client import AsyncMapClient, BadParameter, MapClient
from ogm_core.files.map_files import read_npz

PATIENCE = 30.0
SIZES = {"fine": 0.25, "coarse": 0.5}


@pytest.fixture(scope="module")
def counted(start_mapper):
    with start_mapper(map={"resolution": 0.5, "cell_model": "rate"}) as mapper:
        mapper.draw_cross()
        yield mapper


def address(mapper, over):
    return str(mapper.http.base_url) if over == "http" else mapper.endpoint


@pytest.mark.parametrize("over", ["http", "zenoh"])
@pytest.mark.parametrize("resolution", SIZES)
def test_every_way_to_a_map_has_the_cells_that_are_asked_for(counted, over, resolution):
    served = counted.http.get("/map.npz", params={"resolution": resolution})
    expected = read_npz(served.content)
    with MapClient(address(counted, over), map_name="hall", timeout=PATIENCE) as client:
        grids = [client.get_map(resolution=resolution), next(client.watch(resolution=resolution))]
        with client.follow(resolution=resolution) as follower:
            follower.wait(timeout=PATIENCE)
            grids.append(follower.grid())
        part = client.get_map((0.0, 0.0, 1.0, 0.5), resolution=resolution)

    async def asked():
        async with AsyncMapClient(address(counted, over), map_name="hall", timeout=PATIENCE) as client:
            grid = await anext(client.watch(resolution=resolution))
            return [await client.get_map(resolution=resolution), grid]

    for grid in grids + asyncio.run(asked()):
        assert (grid.resolution, grid.offset) == (SIZES[resolution], expected.offset)
        np.testing.assert_allclose(grid.log_odds, expected.log_odds, rtol=2e-7)
    assert part.log_odds.shape == (round(0.5 / SIZES[resolution]), round(1.0 / SIZES[resolution]))


def test_fine_is_what_is_had_without_a_word(counted):
    with MapClient(counted.endpoint, map_name="hall", timeout=PATIENCE) as client:
        assert client.get_map().resolution == next(client.watch()).resolution == 0.25


def test_of_log_odds_both_are_the_same(cross):
    with MapClient(cross.endpoint, map_name="hall", timeout=PATIENCE) as client:
        maps = [client.get_map(resolution=name) for name in SIZES]
        maps += [next(client.watch(resolution=name)) for name in SIZES]
        for grid in maps[1:]:
            assert grid.resolution == maps[0].resolution
            np.testing.assert_array_equal(grid.log_odds, maps[0].log_odds)


@pytest.mark.parametrize("method", ["get_map", "follow", "watch"])
def test_another_resolution_is_refused_at_once(counted, method):
    told = pytest.raises(BadParameter, match="resolution: one of fine, coarse is needed, got 'best'")
    with MapClient(counted.endpoint, map_name="hall", timeout=PATIENCE) as client, told:
        getattr(client, method)(resolution="best")
