"""The seam of the cell model: a second model, tiny and all its own, through every part that carries cells.

It counts how many beams passed a cell and, on a plane twice as fine, how many ended in each quarter of it, by
the side that they came from. Sums do not depend on order, and its probability looks one cell around.
"""

import io
import json

import numpy as np
import pytest
from PIL import Image

import naive
from counts_model import ENDED, PASSED, SCANS, Counts, quarter, scans
from ogm_client import MapGrid
from ogm_core.cells.classes import OCCUPIED, probability_grey, trinary
from ogm_core.errors import BadSetting, LimitReached
from ogm_core.files.map_files import encode_json, encode_npz, encode_pgm, encode_png
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.quality.figures import Consistency, quality_figures
from ogm_core.quality.truth import occupied_cells, truth_figures
from ogm_core.simulation.worlds import lab
from ogm_core.tiles import store as store_module
from ogm_core.types import PlacedScan, Pose, Scan


class Twin:
    """Two dictionaries."""

    def __init__(self, settings):
        self.settings, self.passed, self.ended = settings, {}, {}

    def integrate(self, scan, pose):
        bounds = self.settings.bounds_rect
        for start, end, hit, line in naive.observed(scan, pose, self.settings):
            for cell, occupied in naive.evidence(start, end, hit, line):
                if bounds is not None and not (0 <= cell[0] < bounds.width and 0 <= cell[1] < bounds.height):
                    continue
                if occupied:
                    x, y = quarter(start, end)
                    fine = 2 * cell[0] + x, 2 * cell[1] + y
                    self.ended[fine] = self.ended.get(fine, 0) + 1
                else:
                    self.passed[cell] = self.passed.get(cell, 0) + 1

    def rect(self):
        cells = {(i // 2, j // 2) for i, j in self.ended} | set(self.passed)
        (west, east), (south, north) = ((min(part), max(part)) for part in zip(*cells, strict=True))
        return CellRect(west, south, east - west + 1, north - south + 1)

    def planes(self, rect):
        passed = np.zeros((rect.height, rect.width), np.uint16)
        ended = np.zeros((2 * rect.height, 2 * rect.width), np.uint32)
        for (i, j), count in self.passed.items():
            passed[j - rect.iy, i - rect.ix] = count
        for (i, j), count in self.ended.items():
            ended[j - 2 * rect.iy, i - 2 * rect.ix] = count
        return {PASSED: passed, ENDED: ended}

    def probability(self, i, j):
        def hits(i, j):
            return sum(self.ended.get((2 * i + x, 2 * j + y), 0) for x in (0, 1) for y in (0, 1))

        own, passed = hits(i, j), self.passed.get((i, j), 0)
        if own + passed == 0:
            return None
        around = sum(hits(i + x, j + y) for x in (-1, 0, 1) for y in (-1, 0, 1))
        return (own + 0.1 * around + 0.1) / (own + passed + 0.1 * around + 0.2)


def maps(order=1, **changes):
    settings = GridSettings(**{"resolution": 0.1, "cell_model": Counts(), **changes})
    grid, twin = OccupancyGrid(settings, "e"), Twin(settings)
    for scan, pose in list(scans())[::order]:
        twin.integrate(scan, pose)
        grid.integrate(scan, pose)
    return grid, twin


BOUNDS = Region(-5.0, -4.0, 12.3, 9.7)
EVERYWHERE = pytest.mark.parametrize("changes", [{}, {"bounds": BOUNDS}], ids=["unbounded", "bounded"])


def pixels(picture, grid):
    return np.asarray(Image.open(io.BytesIO(picture.png(grid.snapshot()))))


@EVERYWHERE
def test_planes_and_probabilities_are_the_twins(changes):
    grid, twin = maps(**changes)
    snapshot = grid.snapshot()
    rect = CellRect(0, 0, 173, 137) if changes else twin.rect()
    assert grid.rect == snapshot.rect == rect
    stored, expected = snapshot.stored.planes(), twin.planes(rect)
    for name in (PASSED, ENDED):
        assert stored[name].dtype == expected[name].dtype
        assert np.array_equal(stored[name], expected[name])
    assert stored[ENDED].sum() > 200
    p, known = snapshot.published()
    for j in range(rect.height):
        for i in range(rect.width):
            of_twin = twin.probability(i + rect.ix, j + rect.iy)
            assert known[j, i] == (of_twin is not None)
            assert p[j, i] == pytest.approx(0.5 if of_twin is None else of_twin, abs=1e-15)
    assert snapshot.known_cells == np.count_nonzero(known)


def test_growth_moves_all_planes(monkeypatch):
    monkeypatch.setattr(store_module, "_FIRST_ROOM", 0)
    moved = []
    take = store_module.TileStore.take
    monkeypatch.setattr(
        store_module.TileStore,
        "take",
        lambda self, other: (moved.append(other.tiles_used), take(self, other)),
    )
    grid, twin = maps()
    assert sum(used > 0 for used in moved) >= 3
    stored, expected = grid.snapshot().stored.planes(), twin.planes(grid.rect)
    assert all(np.array_equal(stored[name], expected[name]) for name in expected)


def test_order_does_not_matter():
    one, other = (maps(order)[0].snapshot().stored.planes() for order in (1, -1))
    assert all(np.array_equal(one[name], other[name]) for name in one)


def test_snapshots_share_what_has_not_changed_and_keep_what_they_had():
    settings = GridSettings(resolution=0.1, cell_model=Counts())
    grid, twin, kept = OccupancyGrid(settings, "e"), Twin(settings), []
    for scan, pose in scans():
        grid.integrate(scan, pose)
        twin.integrate(scan, pose)
        snapshot = grid.snapshot(grid.room_for_snapshot()())
        kept.append((snapshot, twin.planes(snapshot.rect)))
    for snapshot, planes in kept:
        assert all(np.array_equal(snapshot.stored.planes()[name], planes[name]) for name in planes)


def test_a_part_is_published_as_in_the_whole():
    snapshot = maps()[0].snapshot()
    p, known = snapshot.published()
    rows, columns = slice(40, 90), slice(33, 150)
    assert np.array_equal(snapshot.published(rows, columns)[0], p[rows, columns])
    x, y = snapshot.origin
    part = snapshot.crop(Region(x + 3.31, y + 4.01, x + 14.99, y + 8.99))
    assert np.array_equal(part.published()[0], p[rows, columns])
    assert np.array_equal(part.published()[1], known[rows, columns])


@EVERYWHERE
def test_pictures_and_files_show_it(changes):
    grid, _ = maps(**changes)
    snapshot = grid.snapshot()
    p, known = snapshot.published()
    greys = np.where(known & (p > 0.65), 0, np.where(known & (p < 0.196), 254, 205))[::-1]
    assert {0, 254, 205} == set(np.unique(greys).tolist())
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(encode_png(snapshot)))), greys)
    assert encode_pgm(snapshot).endswith(greys.astype(np.uint8).tobytes())
    brightness = np.where(known, np.floor(255.0 * p + 0.5), 127)[::-1]
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(encode_png(snapshot, "probability")))), brightness)
    with np.load(io.BytesIO(encode_npz(snapshot))) as file:
        for name, cells in snapshot.stored.planes().items():
            assert np.array_equal(file[name], cells)
        assert file["offset"].tolist() == list(snapshot.offset)
    document = json.loads(encode_json(snapshot, "m"))
    assert np.array_equal(np.reshape(document["data"], known.shape) == -1, ~known)


@EVERYWHERE
def test_the_live_picture_follows_it(changes):
    grid, _ = maps(**changes)
    picture = MapPicture(probability_grey)
    for scan, pose in list(scans())[::-1]:
        grid.integrate(scan, pose)
        assert np.array_equal(pixels(picture, grid), grid.snapshot().encode(probability_grey)[::-1])


def test_the_live_picture_is_drawn_again_where_only_the_neighbours_have_changed():
    """Probabilities look one cell around: those of row 63, the last of its tiles, change with row 64."""
    grid = OccupancyGrid(GridSettings(resolution=0.1, cell_model=Counts()), "e")
    picture = MapPicture(probability_grey)
    along = Scan(0, 0.0, 0.1, 0.1, 8.0, np.full(1, 3.0, np.float32))
    for row in (10, 63):
        grid.integrate(along, Pose(1.05, 0.05 + 0.1 * row, 0.0))
    before = pixels(picture, grid)
    far, last = dict(picture._strips)[0], before[0, -1]
    grid.integrate(along, Pose(1.05, 0.05 + 0.1 * 64, 0.0))
    after = pixels(picture, grid)
    assert after[1, -1] != last
    assert np.array_equal(after, grid.snapshot().encode(probability_grey)[::-1])
    assert picture._strips[0] is not far


def test_a_client_takes_it_as_log_odds():
    snapshot = maps()[0].snapshot()
    p, known = snapshot.published()
    grid = MapGrid.from_snapshot(snapshot)
    assert np.array_equal(grid.known, known)
    np.testing.assert_allclose(grid.probability[known], p[known], atol=1e-12)
    assert (grid.origin, grid.epoch, grid.revision) == (snapshot.origin, "e", SCANS)


def test_the_truth_judges_it():
    grid, _ = maps()
    snapshot = grid.snapshot()
    p, known = snapshot.published()
    right = (p > 0.5) == occupied_cells(lab(), snapshot.lattice, snapshot.rect)
    assert truth_figures(snapshot, lab())["accuracy"] == pytest.approx(right[known].mean())


def test_shrunk_occupied_wins_then_free():
    snapshot = maps()[0].snapshot()
    small = snapshot.shrink(100)
    factor = small.factor
    assert factor > 1
    classes, (p, known) = snapshot.encode(trinary), snapshot.published()
    for j in range(small.height):
        for i in range(small.width):
            block = slice(j * factor, (j + 1) * factor), slice(i * factor, (i + 1) * factor)
            if (classes[block] == OCCUPIED).any():
                expected = p[block][known[block]].max()
            elif known[block].any():
                expected = p[block][known[block]].min()
            else:
                expected = 0.5
            assert small.published()[0][j, i] == expected
            assert small.published()[1][j, i] == known[block].any()


def test_figures_judge_it():
    grid, twin = maps()
    snapshot = grid.snapshot()
    consistency = Consistency(snapshot, grid.settings)
    for scan, pose in scans():
        consistency.add(PlacedScan(scan, pose))
    figures = quality_figures(snapshot, consistency, grid.cell_updates)
    known = {(i // 2, j // 2) for i, j in twin.ended} | set(twin.passed)
    p = np.array([twin.probability(*cell) for cell in known])
    q = 1.0 - p
    assert figures["known_m2"] == pytest.approx(0.01 * len(known))
    assert figures["occupied_m2"] == pytest.approx(0.01 * np.count_nonzero(p > 0.65))
    assert figures["entropy_bits"] == pytest.approx(float(-(p * np.log2(p) + q * np.log2(q)).sum()))
    assert figures["cell_updates"] == sum(twin.passed.values()) + sum(twin.ended.values())
    assert 0.3 < figures["consistency"]["hits"] <= 1.0


def test_bytes_count_all_planes_and_too_many_are_refused_whole():
    grid, _ = maps(max_bytes=2**31)
    tile = 64 * 64 * 2 + 128 * 128 * 4
    assert grid._store.tile_bytes == tile
    small = OccupancyGrid(GridSettings(resolution=0.1, cell_model=Counts(), max_bytes=12 * tile), "e")
    placed = list(scans())
    for scan, pose in placed[:2]:
        small.integrate(scan, pose)
    before = small.snapshot().stored.planes()
    with pytest.raises(LimitReached, match=f"tiles of {tile} bytes"):
        small.integrate(*placed[-1])
    after = small.snapshot().stored.planes()
    assert small.revision == 2
    assert all(np.array_equal(after[name], before[name]) for name in after)


def test_a_map_begins_with_its_planes():
    grid, twin = maps()
    planes = twin.planes(grid.rect)
    begun = OccupancyGrid(grid.settings, "f")
    begun.begin_with(planes)
    stored = begun.snapshot().stored.planes()
    assert begun.rect == CellRect(0, 0, grid.rect.width, grid.rect.height)
    assert all(np.array_equal(stored[name], planes[name]) for name in planes)


def test_evidence_that_it_does_not_take_is_refused_by_name():
    with pytest.raises(BadSetting, match=r"^sensor_model: cell model counts takes beam, not sector$"):
        GridSettings(cell_model=Counts(), sensor_model="sector")
