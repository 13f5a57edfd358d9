"""Maps with a clip: those of rectangles that meet edge to edge hold, together, the whole map, bit for bit."""

import math
import os
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadParameter, BadSetting, LimitReached, MapEmpty, NoRoom, OutsideBounds
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Clip, Region
from ogm_core.logs.recordings import RecordedScan, RecordingReader
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import PlacedScan, Pose, Scan, Sweep

SECOND = 10**9
DATASETS = os.environ.get("OGM_DATASETS")
ONE, TWO, FOUR = ((), ()), ((64,), ()), ((-64, 64), (0,))
"""Cuts in x and in y, cells: of one, two and six rectangles, the outer ones open. Bounds move them."""
CUTS = pytest.mark.parametrize("cuts", [ONE, TWO, FOUR], ids=["1", "2", "6"])
BOUNDS = Region(-20.0, -15.0, 30.0, 20.0)
"""Of 200 x 140 cells: their edges are none of tiles, and the cell at (-20, -15) is cell (0, 0)."""
KINDS = {
    "bresenham": {},
    "bresenham float64": {"cell_model": LogOdds("float64")},
    "dda": {"traversal": "dda"},
    "dda float64": {"traversal": "dda", "cell_model": LogOdds("float64")},
    "sector": {"sensor_model": "sector"},
    "sector float64": {"sensor_model": "sector", "cell_model": LogOdds("float64")},
    "rate": {"cell_model": Rate()},
    "half-life": {"half_life": 20.0},
}
KINDS_OF_MAPS = pytest.mark.parametrize("kind", KINDS)
PLACES = pytest.mark.parametrize(
    "place",
    [{}, {"bounds": BOUNDS}, {"bounds": BOUNDS, "outside": "drop"}],
    ids=["unbounded", "bounds clip", "bounds drop"],
)


def clips(cuts):
    """The rectangles that cuts make, row by row from the south-west."""
    columns, rows = (list(pairwise([None, *edges, None])) for edges in cuts)
    return [Clip(xmin, ymin, xmax, ymax) for ymin, ymax in rows for xmin, xmax in columns]


def scans(count, seed=5):
    """Of a robot that strays over many tiles on both sides of the anchor; some were taken while it drove."""
    rng = np.random.default_rng(seed)
    x, y = 0.013, 0.007
    for k in range(count):
        x, y = (0.8 * x, 0.8 * y) if rng.random() < 0.2 else (x + rng.normal(0, 5), y + rng.normal(0, 4))
        ranges = rng.uniform(0.5, 13.0, 40).astype(np.float32)
        pose = Pose(x, y, rng.uniform(-4, 4))
        scan = Scan(k * SECOND, -math.pi, math.tau / 40, 0.1, 12.0, ranges)
        beams = np.array([pose]) + np.linspace(0.0, 0.3, 40)[:, None] * (1.0, 0.5, 0.2)
        yield PlacedScan(scan, pose, Sweep(pose, beams) if k % 5 == 4 else None)


def grid_of(**changes):
    return OccupancyGrid(GridSettings(**{"resolution": 0.25, "alpha": 0.5, **changes}), "e", "r")


def parts_of(grid, cuts):
    """An empty map for every rectangle of the cuts, with the settings of a map."""
    if grid.bounds is not None:
        cuts = [edge + 128 for edge in cuts[0]], [edge + 64 for edge in cuts[1]]
    return [OccupancyGrid(replace(grid.settings, clip=clip), "e", "r") for clip in clips(cuts)]


def taken(grid, placed):
    """Whether the map takes a scan; else the text of its refusal."""
    try:
        grid.integrate(*placed)
    except (LimitReached, OutsideBounds) as refusal:
        return str(refusal)
    return True


def tiles(grid):
    """Every tile, with its revision and its bytes."""
    return {
        (tile.tx, tile.ty): (tile.revision, {name: cells.tobytes() for name, cells in tile.planes.items()})
        for tile in grid.checkpoint().tiles_since(0)
    }


def assert_together(whole, parts):
    """Assert that parts hold the cells of a map, each those of its clip, and tell the same of it."""
    found, rect = {}, CellRect(0, 0, 0, 0)
    for part in parts:
        held = tiles(part)
        assert not found.keys() & held.keys()
        clip = part.settings.clip.rect
        assert all(clip.contains(CellRect(64 * tx, 64 * ty, 64, 64)) for tx, ty in held)
        room = part._store.rect
        assert room.cells == 0 or clip.contains(room)
        found |= held
        if part.rect.cells:
            rect = rect.union(part.rect) if rect.cells else part.rect
        assert (part.revision, part.stamp, part.time) == (whole.revision, whole.stamp, whole.time)
    assert found == tiles(whole)
    assert rect == whole.rect
    assert sum(part.cell_updates for part in parts) == whole.cell_updates


@CUTS
@PLACES
@KINDS_OF_MAPS
def test_parts_together_are_the_map(kind, place, cuts):
    whole = grid_of(**KINDS[kind], **place)
    parts = parts_of(whole, cuts)
    for placed in scans(60):
        outcome = taken(whole, placed)
        assert [taken(part, placed) for part in parts] == [outcome] * len(parts)
    assert whole.revision > 20
    assert_together(whole, parts)
    assert len(tiles(whole)) > len(parts)


@KINDS_OF_MAPS
def test_parts_that_are_pasted_serve_the_map(kind):
    whole = grid_of(**KINDS[kind])
    parts = parts_of(whole, FOUR)
    for placed in scans(40):
        for grid in (whole, *parts):
            grid.integrate(*placed)
    pasted = grid_of(**KINDS[kind])
    checkpoints = [part.checkpoint() for part in parts]
    pasted.restore(
        whole.checkpoint().state, (tile for checkpoint in checkpoints for tile in checkpoint.tiles_since(0))
    )
    expected, found = whole.snapshot().finest(), pasted.snapshot().finest()
    assert found.offset == expected.offset
    for name, cells in whole.model.arrays(whole.snapshot().stored).items():
        assert pasted.model.arrays(pasted.snapshot().stored)[name].tobytes() == cells.tobytes(), name


@KINDS_OF_MAPS
@pytest.mark.parametrize("place", [{}, {"bounds": BOUNDS}], ids=["unbounded", "bounded"])
def test_parts_that_begin_with_a_map_are_erased_and_restored_are_the_map(kind, place):
    before = grid_of(**KINDS[kind], **place)
    for placed in scans(10, seed=6):
        before.integrate(*placed)
    whole = grid_of(**KINDS[kind], **place)
    parts = parts_of(whole, FOUR)
    snapshot = before.snapshot()
    area = Polygon(((-9.0, -8.0), (19.0, -7.0), (12.0, 9.0)), whole.lattice)
    erased = []
    for grid in (whole, *parts):
        grid.begin_with(snapshot.stored.planes(), snapshot.offset)
    assert_together(whole, parts)
    for k, placed in enumerate(scans(30)):
        for grid in (whole, *parts):
            grid.integrate(*placed)
        if k == 15:
            erased = [grid.erase(area) for grid in (whole, *parts)]
        if k == 20:
            parts = [restored(part) for part in parts]
    assert erased[0] == sum(erased[1:]) > 100
    assert_together(whole, parts)


def restored(part):
    again = OccupancyGrid(part.settings, "e", "r")
    checkpoint = part.checkpoint()
    again.restore(checkpoint.state, checkpoint.tiles_since(0))
    return again


def east(x, length=10.0):
    """One beam to the east from (x, 0.1)."""
    return PlacedScan(Scan(1, 0.0, 0.1, 0.1, 200.0, np.array([length], np.float32)), Pose(x, 0.1, 0.0))


def test_parts_refuse_the_scans_that_the_map_refuses_wherever_they_lie():
    whole = grid_of(max_cells=500, max_scan_cells=300)
    parts = parts_of(whole, FOUR)
    outcomes = []
    for x, length in ((-30, 10), (1, 160), (10, 10), (30, 10), (90, 10), (31, 10), (-100, 10)):
        placed = east(x, length)
        outcomes.append(taken(whole, placed))
        assert [taken(part, placed) for part in parts] == [outcomes[-1]] * 6
        parts = [restored(part) for part in parts]
    assert [outcome is True for outcome in outcomes] == [True, False, True, True, False, True, False]
    assert_together(whole, parts)


def test_what_parts_begin_with_counts_wherever_it_lies():
    before = grid_of()
    before.integrate(*east(60.0))
    snapshot = before.snapshot()
    parts = parts_of(grid_of(max_cells=290), TWO)
    for part in parts:
        part.begin_with(snapshot.stored.planes(), snapshot.offset)
        assert taken(part, east(-1.0)) is True
        assert "300 x 1 cells" in taken(part, east(-5.0, 3.0))
    assert parts[0].rect.width == 40
    with pytest.raises(LimitReached, match="41 x 1 cells"):
        parts_of(grid_of(max_cells=40), TWO)[0].begin_with({"log_odds": np.ones((1, 41), np.int16)}, (100, 0))
    with pytest.raises(OutsideBounds):
        parts_of(grid_of(bounds=BOUNDS), TWO)[0].begin_with(snapshot.stored.planes(), (180, 0))


def test_a_part_without_memory_drops_its_cells_only_and_goes_on_taking_the_same_scans():
    west, beyond = parts_of(grid_of(max_cells=600), TWO)
    for part in (west, beyond):
        assert taken(part, east(8.0)) is True
    west.max_bytes = west.nbytes
    told = west.rect, west.revision, tiles(west)
    crossing = east(-90.0, 120.0)
    with pytest.raises(NoRoom):
        west.integrate(*crossing)
    assert (west.rect, west.revision, tiles(west)) == told
    assert taken(beyond, crossing) is True
    west.max_bytes = 2**30
    assert taken(west, east(70.0)) == taken(beyond, east(70.0)) != True  # noqa: E712 - a text is true, too


def test_a_scan_elsewhere_counts_and_writes_nothing():
    part = OccupancyGrid(GridSettings(resolution=0.25, clip=Clip(xmin=128)), "e")
    nbytes = part.nbytes
    assert part.integrate(*east(0.0)) == 0
    assert (part.revision, part.stamp, part.cell_updates, part.nbytes) == (1, 1, 0, nbytes)
    assert part.rect == CellRect(0, 0, 0, 0)
    assert part.snapshot().known_cells == 0


def test_a_part_reserves_nothing_beyond_its_clip():
    part = OccupancyGrid(GridSettings(resolution=0.25, clip=Clip(-64, -64, 128, 64)), "e")
    part.integrate(*east(0.0))
    assert part._store.rect == CellRect(-64, -64, 192, 128)
    bounded = OccupancyGrid(GridSettings(resolution=0.25, bounds=BOUNDS, clip=Clip(ymin=64, xmax=128)), "e")
    assert bounded.rect == CellRect(0, 64, 128, 76)
    assert bounded._store.rect == CellRect(0, 64, 128, 128)


def test_whether_an_area_is_erased_is_decided_without_the_clip():
    part = parts_of(grid_of(), TWO)[1]
    here, there = (Polygon(((x, -1.0), (x + 2.0, -1.0), (x + 2.0, 1.0)), part.lattice) for x in (2.0, 50.0))
    with pytest.raises(MapEmpty):
        part.erase(here)
    part.integrate(*east(0.0))
    assert part.erase(here) == 0
    assert (part.revision, part.erasures) == (2, 1)
    with pytest.raises(BadParameter, match=r"wholly outside the map, x 0\.25 to 10\.25, y 0 to 0\.25 m"):
        part.erase(there)


@pytest.mark.parametrize(
    ("edges", "named"),
    [
        ({"xmin": 65}, "clip: xmin is cell 65: an edge of tiles is needed, a multiple of 64 cells"),
        ({"ymax": -1}, "clip: ymax is cell -1"),
        ({"xmax": 2**60}, "clip: xmax is cell 1152921504606846976"),
        ({"xmin": 64, "xmax": 64}, "clip: xmin < xmax and ymin < ymax are needed"),
        ({"ymin": 128, "ymax": 64}, "clip: xmin < xmax and ymin < ymax are needed"),
    ],
)
def test_a_clip_that_is_none_is_refused(edges, named):
    with pytest.raises(BadSetting, match=named):
        Clip(**edges)


def test_a_clip_beside_the_bounds_is_refused():
    with pytest.raises(BadSetting, match="clip: no cell of the bounds, 200 x 140, lies in it"):
        GridSettings(resolution=0.25, bounds=BOUNDS, clip=Clip(xmin=256))


@cache
def recorded(name, most):
    with RecordingReader(Path(DATASETS) / name, range_max=80.0) as messages:
        found = [message.message for message in messages if isinstance(message, RecordedScan)]
    return [PlacedScan(scan, scan.pose.compose(scan.mount)) for scan in found[:most]]


@pytest.mark.skipif(DATASETS is None, reason="OGM_DATASETS does not name the folder of recorded logs")
@pytest.mark.parametrize(
    "log",
    ["intel/intel-corrected.log.gz", "freiburg-079/freiburg-079-corrected.log.gz"],
    ids=["intel", "freiburg-079"],
)
@KINDS_OF_MAPS
def test_parts_of_recorded_buildings_are_the_map(kind, log):
    """The first 250 scans: half of a building, and the short way to it."""
    limits = {"reach": 12.0} if kind == "rate" else {"clear_range": 25.0}
    whole = OccupancyGrid(GridSettings(**KINDS[kind], **limits), "e", "r")
    parts = parts_of(whole, ((-128, 0), (0,)))
    for placed in recorded(log, 250):
        outcome = taken(whole, placed)
        assert [taken(part, placed) for part in parts] == [outcome] * len(parts)
    assert_together(whole, parts)
    assert sum(len(tiles(part)) > 3 for part in parts) >= 4
