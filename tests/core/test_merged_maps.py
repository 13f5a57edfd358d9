"""Saved maps of counts, added up: the map of all of their scans, byte for byte."""

from contextlib import suppress
from itertools import permutations

import numpy as np
import pytest

from ogm_core.cells.rate import PLANES, Rate
from ogm_core.cells.rate_sums import add_counts
from ogm_core.errors import BadMapFile, OutsideBounds
from ogm_core.files.map_files import encode_npz
from ogm_core.files.merged_maps import merge_maps
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.types import Pose, Scan

BOUNDS = Region(-7.0, -4.0, 8.0, 10.0)
PLACES = ((-6.0, 1.0), (7.0, -3.0), (0.5, 9.0))


def grid_of(scans, **settings):
    grid = OccupancyGrid(GridSettings(resolution=0.1, cell_model=Rate(), **settings), "e")
    for scan, pose in scans:
        with suppress(OutsideBounds):
            grid.integrate(scan, pose)
    return grid.snapshot()


def random_scans(seed, count=6):
    """Scans around a place of their own, some beams of which meet nothing."""
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        ranges = rng.uniform(0.5, 4.0, 90).astype(np.float32)
        ranges[rng.random(90) < 0.3] = np.inf
        x, y = PLACES[seed % len(PLACES)] + rng.uniform(-3.0, 3.0, 2)
        found.append((Scan(k, -3.0, 0.07, 0.0, 6.0, ranges), Pose(x, y, rng.uniform(-3.0, 3.0))))
    return found


def narrow_scans(length, count):
    """Scans all of whose beams go through the same cells."""
    ranges = np.full(2000, length, np.float32)
    return [(Scan(k, 0.0, 1e-6, 0.0, 6.0, ranges), Pose(0.0, 0.0, 0.3)) for k in range(count)]


def saved(folder, maps):
    paths = [folder / f"{n}.npz" for n in range(len(maps))]
    for path, snapshot in zip(paths, maps, strict=True):
        path.write_bytes(encode_npz(snapshot))
    return paths


@pytest.mark.parametrize("settings", [{}, {"bounds": BOUNDS}, {"bounds": BOUNDS, "outside": "drop"}])
@pytest.mark.parametrize("finest", [True, False])
def test_parts_of_a_log_make_the_map_of_the_whole_in_any_order(tmp_path, settings, finest):
    parts = [random_scans(seed) for seed in (1, 2, 3)]
    whole = grid_of([placed for part in parts for placed in part], **settings)
    maps = [grid_of(part, **settings) for part in parts]
    paths = saved(tmp_path, [snapshot.finest() if finest else snapshot for snapshot in maps])
    assert settings or len({snapshot.rect for snapshot in (whole, *maps)}) == 4
    wanted = encode_npz(whole.finest()), encode_npz(whole)
    for order in permutations(paths):
        merged = merge_maps(order)
        assert (encode_npz(merged.finest()), encode_npz(merged)) == wanted


def test_sums_of_many_beams_are_carried_and_counts_of_what_met_nothing_stop(tmp_path):
    """2000 beams of weight 16 wrap N at the third scan, 33 scans without a hit fill F."""
    parts = narrow_scans(3.0, 2), narrow_scans(3.0, 5), narrow_scans(np.inf, 20), narrow_scans(np.inf, 21)
    whole = grid_of([placed for part in parts for placed in part])
    planes = whole.stored.planes()
    assert planes["F"].max() == 65535 > planes["C"].max() > 2
    merged = merge_maps(saved(tmp_path, [grid_of(part) for part in parts]))
    assert encode_npz(merged) == encode_npz(whole)


def test_an_empty_map_adds_nothing(tmp_path):
    one = grid_of(random_scans(1))
    paths = saved(tmp_path, [grid_of([]), one, grid_of([])])
    assert encode_npz(merge_maps(paths)) == encode_npz(one)
    assert merge_maps(paths[::2]).empty


def test_sums_stop_at_the_largest_number_whatever_the_order():
    rng = np.random.default_rng(3)
    tops = {plane.name: int(np.iinfo(plane.dtype).max) for plane in PLANES}
    maps = []
    for _ in range(3):
        planes = {}
        for plane in PLANES:
            shape = 40 * plane.side, 50 * plane.side
            size = rng.integers(1, plane.dtype.itemsize * 8 + 1, shape)
            planes[plane.name] = (tops[plane.name] >> (size - 1)).astype(plane.dtype)
        maps.append(planes)
    found = []
    for order in permutations(maps):
        sums = {name: cells.copy() for name, cells in order[0].items()}
        for planes in order[1:]:
            add_counts(sums, planes)
        found.append(sums)
    wide = [{name: cells.astype(object) for name, cells in planes.items()} for planes in maps]
    for name in ("F", "E", "H"):
        wanted = np.minimum(sum(planes[name] for planes in wide), tops[name])
        assert (wanted == tops[name]).any()
        assert all(np.array_equal(sums[name], wanted) for sums in found)
    passing = np.minimum(sum(planes["N"] + 65536 * planes["C"] for planes in wide), 2**32 - 1)
    assert (passing == 2**32 - 1).any()
    assert all(np.array_equal(sums["N"] + 65536 * sums["C"].astype(int), passing) for sums in found)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (
            {"resolution": 0.05},
            r"1.npz: its scans were counted in cells of 0.05 m, those .*0.npz in .* 0.1 m",
        ),
        (
            {"bounds": BOUNDS},
            r"1.npz: its cells are counted from \(-7.0, -4.0\), those .*0.npz from \(0",
        ),
        ({"anchor": (0.0, 1e-9)}, r"1.npz: its cells are counted from \(0.0, 1e-09\)"),
    ],
)
def test_maps_of_other_lattices_are_refused(tmp_path, settings, message):
    scans = random_scans(1)
    other = OccupancyGrid(GridSettings(**({"resolution": 0.1, "cell_model": Rate()} | settings)), "e")
    with pytest.raises(BadMapFile, match=message):
        merge_maps(saved(tmp_path, [grid_of(scans), other.snapshot()]))


def test_maps_that_lie_too_far_apart_are_refused(tmp_path):
    parts = [random_scans(seed) for seed in (1, 2)]
    paths = saved(tmp_path, [grid_of(part) for part in parts])
    cells = grid_of([placed for part in parts for placed in part]).rect.cells
    merge_maps(paths, max_cells=cells)
    with pytest.raises(BadMapFile, match=rf"1.npz: with it .* and {cells - 1} cells are the most"):
        merge_maps(paths, max_cells=cells - 1)


def test_maps_that_have_forgotten_some_are_refused(tmp_path):
    scans = random_scans(1)
    paths = saved(tmp_path, [grid_of(scans), grid_of(scans, half_life=60.0)])
    with pytest.raises(BadMapFile, match=r"1.npz: its counts were halved .*without --half-life$"):
        merge_maps(paths)
