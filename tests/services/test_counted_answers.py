"""What a mapper answers of a map that counts: in cells of half the size, or in its own."""

import io
import json

import numpy as np
import pytest
from PIL import Image

from ogm_core.cells.classes import ros_grey, trinary
from ogm_core.cells.rate import Rate
from ogm_core.cells.value_bytes import value_byte
from ogm_core.errors import BadParameter
from ogm_core.files.map_files import read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Region
from ogm_core.placing.receipts import Receipts
from ogm_core.tiles.pyramid import Square
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.map_formats import MAP_FORMATS

BOUNDS = Region(-4.0, -3.5, 5.0, 4.5)


class Desk:
    def __init__(self, **changes):
        settings = GridSettings(**{"resolution": 0.1, "cell_model": Rate(), **changes})
        self.live = LiveMap(OccupancyGrid(settings, "epoch", "run"))
        self.answers = Answers("hall", self.live, Receipts(), Monitor(self.live))
        self.rng = np.random.default_rng(3)

    def scan(self, count=1):
        for _ in range(count):
            ranges = self.rng.uniform(0.5, 6.0, 90).astype(np.float32)
            scan = Scan(0, -3.0, 0.07, 0.0, 5.5, np.where(ranges > 5.5, np.inf, ranges).astype(np.float32))
            self.live.integrate(scan, Pose(*self.rng.uniform(-2.0, 2.0, 3)))

    def map(self, form, **given):
        return self.answers.map(form, given)


@pytest.fixture(params=[{}, {"bounds": BOUNDS}], ids=["unbounded", "bounded"])
def desk(request):
    desk = Desk(**request.param)
    desk.scan(4)
    return desk


def pixels(body):
    return np.asarray(Image.open(io.BytesIO(body)))[::-1]


def test_formats_have_the_cells_that_their_readers_expect(desk):
    coarse = desk.live.snapshot()
    fine = coarse.finest()
    for form in MAP_FORMATS:
        for given, meta in (
            ({}, (coarse if form in ("pgm", "yaml") else fine).meta()),
            ({"resolution": "fine"}, fine.meta()),
            ({"resolution": "coarse"}, coarse.meta()),
        ):
            assert desk.map(form, **given).meta == meta, form
    for snapshot, name in ((fine, "fine"), (coarse, "coarse")):
        greys = snapshot.encode(ros_grey)
        assert np.array_equal(pixels(desk.map("png", resolution=name).body), greys)
        assert np.array_equal(pixels(desk.map("pgm", resolution=name).body), greys)
        document = json.loads(desk.map("json", resolution=name, values="trinary").body)
        assert document["resolution"] == snapshot.resolution
        assert np.array_equal(np.reshape(document["data"], greys.shape), snapshot.encode(trinary))
        npz = read_npz(desk.map("npz", resolution=name).body)
        assert (npz.resolution, npz.offset) == (snapshot.resolution, snapshot.offset)
        assert np.array_equal(~np.isnan(npz.log_odds), snapshot.published()[1])
    assert f"resolution: {coarse.resolution}\n" in desk.map("yaml").body.decode()
    with pytest.raises(BadParameter, match="resolution: one of fine, coarse is needed, got 'best'"):
        desk.map("png", resolution="best")


def test_the_live_picture_follows_the_map(desk):
    for _ in range(3):
        desk.scan()
        fine = desk.live.snapshot().finest()
        assert np.array_equal(pixels(desk.map("png").body), fine.encode(ros_grey))
        part = desk.map("png", region="-1.02,-0.98,1.51,1.53")
        x, y = (part.meta["offset"][n] - fine.offset[n] for n in (0, 1))
        shown = pixels(part.body)
        assert part.meta["offset"][0] % 2 == 1
        assert np.array_equal(shown, fine.encode(ros_grey)[y : y + len(shown), x : x + shown.shape[1]])


def square_of(fine, rect):
    """Value bytes of the fine cells of a rectangle; 0 beyond the map."""
    found = np.zeros((rect.height, rect.width), np.uint8)
    inside = rect.intersection(fine.rect)
    if inside.cells:
        x, y = inside.ix - rect.ix, inside.iy - rect.iy
        found[y : y + inside.height, x : x + inside.width] = fine.part(inside).encode(value_byte)
    return found


def test_tiles_show_fine_cells(desk):
    seen = 0
    for _ in range(2):
        desk.scan()
        fine = desk.live.snapshot().finest()
        for x in (-1, 0):
            for y in (-1, 0):
                tile = desk.answers.map_tiles.tile(Square(16, x, y), "probability")
                wanted = square_of(fine, CellRect(256 * x, 256 * (-1 - y), 256, 256))
                assert tile.resolution == 0.05
                assert np.array_equal(pixels(tile.png), wanted)
                seen += np.count_nonzero(wanted)
        # The same at half the resolution: occupied wins, then free.
        tile = desk.answers.map_tiles.tile(Square(15, -1, 0), "probability")
        wanted = square_of(fine, CellRect(-512, -512, 512, 512)).reshape(256, 2, 256, 2)
        most = wanted.max(axis=(1, 3))
        least = np.where(wanted == 0, 255, wanted).min(axis=(1, 3))
        assert np.array_equal(pixels(tile.png), np.where(most >= 167, most, np.where(most == 0, 0, least)))
    assert seen > 10_000
    described = json.loads(desk.answers.tiles("/").body)
    assert described["ogm"]["resolution"] == 0.05


def test_a_cell_tells_its_counts(desk):
    fine = desk.live.snapshot().finest()
    p, _ = fine.published()
    hits = fine.stored.planes()["hits"]
    row, column = np.argwhere(hits == hits.max())[0].tolist()
    x, y = (fine.origin[n] + 0.05 * (at + 0.5) for n, at in ((0, column), (1, row)))
    cell = json.loads(desk.answers.cell({"x": str(x), "y": str(y)}).body)
    assert (cell["ix"], cell["iy"]) == (column + fine.offset[0], row + fine.offset[1])
    assert cell["known"]
    assert cell["probability"] == p[row, column]
    counts = cell["counts"]
    assert counts["hits"] == hits[row, column] / 1024
    assert counts["passing_m"] == pytest.approx(fine.stored.planes()["passing"][row, column] / 32 * 0.05)
    assert counts["no_returns"] == fine.stored.planes()["unanswered"][row, column]
    coarse = json.loads(desk.answers.cell({"x": str(x), "y": str(y), "resolution": "coarse"}).body)
    assert (coarse["ix"], coarse["iy"]) == (cell["ix"] // 2, cell["iy"] // 2)
    assert coarse["counts"]["hits"] >= counts["hits"]
    outside = json.loads(desk.answers.cell({"x": "900", "y": "0"}).body)
    assert (outside["known"], "counts" in outside) == (False, False)


def test_questions_are_answered_of_fine_cells(desk):
    fine = desk.live.snapshot().finest()
    states = fine.encode(trinary)
    layer = np.load(io.BytesIO(desk.answers.queries.distance("npz", {}).body))
    assert layer["distance"].shape == states.shape
    assert layer["resolution"] == 0.05
    assert np.array_equal(layer["distance"] == 0.0, states == 100)
    ray = json.loads(
        desk.answers.queries.raycast(
            {"x": "0.01", "y": "0.01", "n": "1", "range_max": "5", "unknown": "pass"}
        ).body
    )
    ix, iy = fine.lattice.cell_of(0.01, 0.01)
    column, row = ix - fine.offset[0], iy - fine.offset[1]
    ahead = np.flatnonzero(states[row, column:] == 100)
    assert ray["ranges"] == [pytest.approx(ahead[0] * 0.05 - 0.01)]


def test_it_is_judged_in_fine_cells_live_and_by_a_build(desk):
    live = desk.answers.quality_fields(fresh=True)
    p, known = desk.live.snapshot().finest().published()
    assert live["known_m2"] == pytest.approx(np.count_nonzero(known) * 0.05**2)
    assert live["occupied_m2"] == pytest.approx(np.count_nonzero(p > 0.65) * 0.05**2)
    assert 0.5 < live["consistency"]["hits"] < 1.0
