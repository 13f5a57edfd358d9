import io
import json
import zipfile

import numpy as np
import pytest
import yaml
from PIL import Image

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.classes import probability_grey, ros_grey, trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadInput, BadParameter, MapEmpty
from ogm_core.files.map_files import (
    PALETTES,
    encode_json,
    encode_npz,
    encode_pgm,
    encode_png,
    encode_yaml,
    read_npz,
)
from ogm_core.lattice import Lattice, Region
from ogm_core.snapshot import MapSnapshot

MODELS = [LogOdds("int16"), LogOdds("float64"), LogOdds("int16", p_prior=0.3, p_free=0.2)]
model_of_every_kind = pytest.mark.parametrize("model", MODELS, ids=lambda m: f"{m.cells}, prior {m.p_prior}")


def map_of(model, height=23, width=31, seed=2):
    """A map with unknown, free, occupied, undecided and back-to-zero cells, different at every edge."""
    rng = np.random.default_rng(seed)
    shape = height, width
    if model.cells == "int16":
        steps = np.where(rng.random(shape) < 0.2, 0, rng.integers(model.constants.lower // 2, 16384, shape))
        cells = np.where(rng.random(shape) < 0.7, 2 * steps | 1, 0).astype(np.int16)
    else:
        log_odds = np.where(rng.random(shape) < 0.2, -0.0, rng.uniform(-8.0, 8.0, shape))
        cells = np.where(rng.random(shape) < 0.7, log_odds, 0.0)
    return MapSnapshot(
        CellArrays.of(model, cells),
        model,
        Lattice(0.05, (-1.5, 2.0)),
        (-7, 12),
        "e9",
        41,
        1_700_000_000_123_456_789,
    )


def empty_map(model=MODELS[0]):
    return MapSnapshot(
        CellArrays.of(model, np.zeros((0, 0), model.dtype)), model, Lattice(0.05), (0, 0), "e0", 0, None
    )


def pixels(data):
    with Image.open(io.BytesIO(data)) as picture:
        assert picture.mode == "L"
        return np.asarray(picture)


def map_server(pgm, description):
    """What nav2 map_server makes of the pair: occupancy by (ix, iy), row 0 south, and the description."""
    info = yaml.safe_load(description)
    assert (info["mode"], info["negate"]) == ("trinary", 0)
    grey = pixels(pgm)
    height = len(grey)
    cells = {}
    for row in range(height):
        for column in range(grey.shape[1]):
            p = (255 - int(grey[row, column])) / 255
            value = 100 if p > info["occupied_thresh"] else 0 if p < info["free_thresh"] else -1
            cells[column, height - 1 - row] = value
    return cells, info


@model_of_every_kind
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (23, 31)])
def test_map_server_reads_back_the_trinary_map(model, shape):
    snap = map_of(model, *shape)
    cells, info = map_server(encode_pgm(snap), encode_yaml(snap, "map.pgm"))
    expected = model.encode(snap.cells, trinary)
    assert cells == {(ix, iy): expected[iy, ix] for iy in range(shape[0]) for ix in range(shape[1])}
    assert info["image"] == "map.pgm"
    assert (info["resolution"], info["origin"]) == (0.05, [*snap.origin, 0.0])


@model_of_every_kind
@pytest.mark.parametrize(("palette", "encoder"), [("ros", ros_grey), ("probability", probability_grey)])
def test_pictures_are_north_up(model, palette, encoder):
    snap = map_of(model)
    south_first = encoder(model.probability(snap.cells), model.known(snap.cells))
    assert len(np.unique(south_first)) > 2
    assert np.array_equal(pixels(encode_png(snap, palette)), south_first[::-1])
    assert np.array_equal(pixels(encode_pgm(snap, palette)), south_first[::-1])


def test_a_wall_in_the_north_is_at_the_top():
    cells = np.zeros((3, 2), np.int16)
    cells[2, 1] = 9999
    snap = MapSnapshot(CellArrays.of(MODELS[0], cells), MODELS[0], Lattice(1.0), (0, 0), "e", 1, 1)
    assert pixels(encode_png(snap)).tolist() == [[205, 0], [205, 205], [205, 205]]


def test_palettes_by_name():
    assert [PALETTES["ros"], PALETTES["probability"]] == [ros_grey, probability_grey]
    every = "ros, probability, cividis, dark, costmap"
    for encode, names in ((encode_png, every), (encode_pgm, "ros, probability")):
        with pytest.raises(BadParameter, match=f"palette: one of {names} is needed, got 'viridis'"):
            encode(map_of(MODELS[0]), "viridis")
    with pytest.raises(BadParameter, match="values: one of percent, trinary"):
        encode_json(map_of(MODELS[0]), "default", "greys")


@model_of_every_kind
def test_json(model):
    snap = map_of(model)
    got = json.loads(encode_json(snap, "hall.2"))
    data = got.pop("data")
    assert got == {"map": "hall.2", "frame": "map", **snap.meta()}
    assert (got["resolution"], got["width"], got["height"], got["offset"]) == (0.05, 31, 23, [-7, 12])
    p, known = model.probability(snap.cells), model.known(snap.cells)
    assert data == [int(100 * v + 0.5) if k else -1 for v, k in zip(p.flat, known.flat, strict=True)]
    assert {-1, 0, 100} < set(data)
    three = json.loads(encode_json(snap, "hall.2", "trinary"))
    assert three.pop("data") == model.encode(snap.cells, trinary).ravel().tolist()
    assert three == got


@model_of_every_kind
def test_json_of_a_crop_and_of_one_cell(model):
    snap = map_of(model)
    x, y = snap.lattice.corner_of(0, 20)
    part = snap.crop(Region(x + 0.01, y + 0.01, x + 0.14, y + 0.09))
    assert not part.cells.flags.c_contiguous
    got = json.loads(encode_json(part, "m"))
    whole = np.array(json.loads(encode_json(snap, "m"))["data"]).reshape(23, 31)
    assert got["offset"] == [0, 20]
    assert got["data"] == whole[8:10, 7:10].ravel().tolist()
    one = json.loads(encode_json(map_of(model, 1, 1), "m"))
    assert (one["width"], len(one["data"])) == (1, 1)


@model_of_every_kind
def test_npz_is_a_plain_numpy_archive(model):
    snap = map_of(model)
    with np.load(io.BytesIO(encode_npz(snap)), allow_pickle=False) as got:
        assert set(got.files) == {"log_odds", "resolution", "origin", "offset", "anchor"}
        log_odds = got["log_odds"]
        assert float(got["resolution"]) == 0.05
        assert got["origin"].tolist() == list(snap.origin)
        assert got["offset"].tolist() == [-7, 12]
        assert got["anchor"].tolist() == [-1.5, 2.0]
    known = model.known(snap.cells)
    assert np.array_equal(np.isnan(log_odds), ~known)
    if model.cells == "float64":
        assert log_odds.dtype == np.float64
        assert np.array_equal(log_odds[known], snap.cells[known])
    else:
        assert log_odds.dtype == np.float32
        exact = [model.l0 + (int(cell) // 2) * model.step for cell in snap.cells[known]]
        assert np.array_equal(log_odds[known], np.array(exact).astype(np.float32))


def test_npz_of_a_map_of_many_bands():
    snap = map_of(MODELS[0], 600, 1700)
    log_odds = read_npz(encode_npz(snap)).log_odds
    expected = np.where(snap.cells != 0, (snap.cells >> 1) * MODELS[0].step, np.nan).astype(np.float32)
    assert np.array_equal(log_odds, expected, equal_nan=True)


@model_of_every_kind
def test_npz_reads_back(model):
    snap = map_of(model)
    data = encode_npz(snap)
    assert data == encode_npz(snap)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        assert {entry.date_time for entry in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    got = read_npz(data)
    assert (got.resolution, got.anchor, got.offset) == (0.05, (-1.5, 2.0), (-7, 12))
    assert [type(value) for value in (got.resolution, *got.anchor, *got.offset)] == [float] * 3 + [int] * 2
    assert got.log_odds.shape == (23, 31)
    assert got.log_odds.dtype == (np.float64 if model.cells == "float64" else np.float32)


@pytest.mark.parametrize("model", MODELS[:2], ids=lambda m: m.cells)
def test_an_empty_map(model):
    snap = empty_map(model)
    for encode in (encode_png, encode_pgm, lambda s: encode_yaml(s, "map.pgm")):
        with pytest.raises(MapEmpty, match="no known cell yet"):
            encode(snap)
    got = json.loads(encode_json(snap, "default"))
    assert (got["width"], got["height"], got["data"], got["stamp"], got["revision"]) == (0, 0, [], None, 0)
    npz = read_npz(encode_npz(snap))
    assert npz.log_odds.shape == (0, 0)
    assert npz.log_odds.dtype == (np.float64 if model.cells == "float64" else np.float32)


def test_a_bounded_map_without_scans_is_drawn_unknown():
    snap = MapSnapshot(
        CellArrays.of(MODELS[0], np.zeros((4, 5), np.int16)), MODELS[0], Lattice(0.1), (0, 0), "e", 0, None
    )
    assert pixels(encode_png(snap)).tolist() == [[205] * 5] * 4
    assert pixels(encode_png(snap, "probability")).tolist() == [[127] * 5] * 4


def archive_of(**replaced):
    arrays = {
        "log_odds": np.zeros((2, 3), np.float32),
        "resolution": np.array(0.05),
        "anchor": np.zeros(2),
        "offset": np.zeros(2, np.int64),
    }
    arrays |= replaced
    file = io.BytesIO()
    np.savez(file, **{name: array for name, array in arrays.items() if array is not None})
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "not a zip file"),
        (b"garbage" * 100, "not a zip file"),
        (b'{"type": "map-empty"}', "not a zip file"),
        (encode_npz(empty_map())[:-10], "not a zip file"),
        (archive_of(anchor=None), "anchor"),
        (archive_of(log_odds=np.array([["pickled", None]], object)), "not a map"),
        (archive_of(log_odds=np.zeros(5, np.float32)), r"log_odds is float32 of shape \(5,\)"),
        (archive_of(log_odds=np.zeros((2, 2), np.int64)), "log_odds is int64"),
        (archive_of(resolution=np.array(0.0)), "resolution"),
        (archive_of(resolution=np.array(np.nan)), "resolution"),
        (archive_of(resolution=np.array("0.05")), "resolution is <U4"),
        (archive_of(resolution=np.ones(2)), "resolution"),
        (archive_of(anchor=np.array([0.0, np.inf])), "anchor"),
        (archive_of(anchor=np.zeros(3)), "anchor"),
        (archive_of(offset=np.zeros(2)), "offset is float64"),
        (archive_of(offset=np.zeros((1, 2), np.int64)), "offset"),
        (archive_of(offset=np.array([-(2**63), 0])), "offset"),
        (archive_of(offset=np.array([0, 2**53])), "offset"),
    ],
)
def test_garbage_is_refused(data, says):
    with pytest.raises(BadInput, match=f"^map.npz: .*{says}"):
        read_npz(data)


def test_damaged_archives_are_refused_or_unharmed():
    good = encode_npz(map_of(MODELS[0]))
    expected = read_npz(good)
    rng = np.random.default_rng(11)
    refused = 0
    for _ in range(400):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= int(rng.integers(1, 256))
        try:
            got = read_npz(bytes(bad))
        except BadInput:
            refused += 1
        else:
            assert np.array_equal(got.log_odds, expected.log_odds, equal_nan=True)
            assert (got.resolution, got.anchor, got.offset) == (0.05, (-1.5, 2.0), (-7, 12))
    assert refused > 300
