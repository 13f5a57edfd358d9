"""A mapper that begins with a ROS map: its cells, its lattice, and what contradicts it."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadMapFile, BadSetting
from ogm_core.files.map_files import encode_pgm, encode_yaml
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.files.ros_map_writer import write_pgm, write_yaml
from ogm_services.cli import app
from ogm_services.mapper.live.start_map import start_cells, started_grid
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import load_settings

EVERY_VALUE = np.arange(-1, 101, dtype=np.int8).reshape(6, 17)
KNOWN = EVERY_VALUE >= 0
MODELS = [
    LogOdds(),
    LogOdds("float64"),
    LogOdds(p_prior=0.3, p_free=0.2, p_occ=0.8, l_min=-4.0, l_max=6.0),
    LogOdds("float64", p_prior=0.3, p_free=0.2, p_occ=0.8, l_min=-4.0, l_max=6.0),
    LogOdds(l_min=-30.0, l_max=30.0),
]


@pytest.fixture
def map_file(tmp_path):
    """A map of 4 x 3 cells of 0.1 m in nav2's format, its lower-left corner at (-1.05, 2.0)."""
    greys = np.array([[0, 254, 254, 205], [254, 254, 0, 205], [205, 205, 205, 205]], np.uint8)
    (tmp_path / "floor.pgm").write_bytes(write_pgm(greys[::-1]))
    path = tmp_path / "floor.yaml"
    path.write_text(write_yaml("floor.pgm", 0.1, (-1.05, 2.0)))
    return path


def settings_with(map_file, **sections):
    mapper = {"start_map": str(map_file), **sections.pop("mapper", {})}
    return Settings.model_validate({"mapper": mapper, **sections})


def classes_of(occupancy):
    return trinary(occupancy / 100.0, occupancy >= 0)


# What a cell is worth.


@pytest.mark.parametrize("confidence", [0.81, 0.9, 0.97])
@pytest.mark.parametrize("model", MODELS, ids=range(len(MODELS)))
def test_every_value_keeps_its_class_and_its_probability(model, confidence):
    cells = start_cells(EVERY_VALUE, model, confidence)
    assert (cells.dtype, cells.shape) == (model.dtype, EVERY_VALUE.shape)
    assert np.array_equal(model.known(cells), KNOWN)
    p = model.probability(cells)
    assert np.array_equal(trinary(p, model.known(cells)), classes_of(EVERY_VALUE))
    wanted = np.clip(EVERY_VALUE / 100.0, 1.0 - confidence, confidence)
    assert np.abs(p - wanted)[KNOWN].max() < 0.0025
    assert not cells[~KNOWN].any()


def test_exact_probabilities_in_float64():
    p = LogOdds("float64").probability(start_cells(EVERY_VALUE, LogOdds("float64"), 0.9)).ravel()
    found = {value: p[value + 1] for value in (0, 5, 10, 11, 50, 64, 66, 90, 100)}
    expected = {0: 0.1, 5: 0.1, 10: 0.1, 11: 0.11, 50: 0.5, 64: 0.64, 66: 0.66, 90: 0.9, 100: 0.9}
    assert found == pytest.approx(expected, abs=1e-12)
    assert 0.64 < p[66] < 0.65, "65 stays below what counts as occupied"


def test_known_at_even_odds_is_not_unknown():
    for cells in ("int16", "float64"):
        model = LogOdds(cells)
        stored = start_cells(np.array([[50, -1]], np.int8), model, 0.9)
        assert model.known(stored).tolist() == [[True, False]]
        assert model.log_odds(stored).tolist() == [[0.0, 0.0]]


def test_the_clamps_hold():
    model = LogOdds("float64", l_min=-2.0, l_max=1.0)
    log_odds = model.log_odds(start_cells(EVERY_VALUE, model, 0.99))
    assert (log_odds.min(), log_odds.max()) == (-2.0, 1.0)


@pytest.mark.parametrize(
    ("model", "confidence"),
    [
        (LogOdds(), 0.8),
        (LogOdds(), 0.66),
        (LogOdds(), 0.51),
        (LogOdds(l_min=-1.0), 0.95),
        (LogOdds(l_max=0.5), 0.95),
        (LogOdds("float64", l_max=0.5), 0.95),
    ],
)
def test_a_confidence_that_makes_nothing_free_or_occupied_is_refused(model, confidence):
    with pytest.raises(
        BadSetting, match=r"^mapper\.start_confidence: with .* raise it, or leave the clamps alone$"
    ):
        start_cells(EVERY_VALUE, model, confidence)


def test_the_least_confidence():
    start_cells(EVERY_VALUE, LogOdds("float64"), 0.8041)
    with pytest.raises(BadSetting, match=r"free ones at 0\.1961; more than 0\.65 and less than 0\.196 are"):
        start_cells(EVERY_VALUE, LogOdds("float64"), 0.8039)


# The map.


def test_a_map_starts_on_the_lattice_of_the_file(map_file):
    grid = started_grid(settings_with(map_file), "life")
    assert (grid.lattice.resolution, grid.lattice.anchor) == (0.1, (-1.05, 2.0))
    assert (grid.epoch, grid.revision, grid.stamp, grid.cell_updates) == ("life", 0, None, 0)
    snapshot = grid.snapshot()
    assert snapshot.offset == (0, 0)
    found = snapshot.model.encode(snapshot.cells, trinary)
    assert found.tolist() == [[100, 0, 0], [0, 0, 100]], "the smallest rectangle of known cells"
    assert snapshot.origin == (-1.05, 2.0)
    assert snapshot.model.probability(snapshot.cells)[0, :2] == pytest.approx([0.9, 0.1], abs=1e-3)


def test_settings_of_the_map_hold_beside_a_start_map(map_file):
    chosen = settings_with(map_file, map={"cells": "float64", "reach": 5.0, "alpha": 0.3})
    grid = started_grid(chosen, "")
    assert grid.model.cells == "float64"
    assert (grid.settings.reach, grid.settings.alpha, grid.bounds) == (5.0, 0.3, None)
    sure = started_grid(settings_with(map_file, mapper={"start_confidence": 0.99}), "").snapshot()
    assert sure.model.probability(sure.cells)[0, 0] == pytest.approx(0.99, abs=1e-3)


def test_without_a_start_map_the_map_is_empty():
    grid = started_grid(Settings(), "life")
    assert grid.snapshot().empty
    assert (grid.epoch, grid.lattice.resolution, grid.lattice.anchor) == ("life", 0.05, (0.0, 0.0))


@pytest.mark.parametrize("source", ["file", "environment", "flag"])
@pytest.mark.parametrize("resolution", [0.05, 0.1])
def test_a_resolution_that_was_given_must_be_that_of_the_file(map_file, tmp_path, source, resolution):
    config = tmp_path / "ogm.yaml"
    config.write_text(f"map: {{resolution: {resolution}}}\n" if source == "file" else "")
    chosen = load_settings(
        config=config,
        flags={
            "map": {"resolution": str(resolution)} if source == "flag" else {},
            "mapper": {"start_map": str(map_file)},
        },
        environ={"OGM_MAP__RESOLUTION": str(resolution)} if source == "environment" else {},
    )
    if resolution == 0.1:
        assert started_grid(chosen, "").lattice.resolution == 0.1
        return
    with pytest.raises(BadSetting) as caught:
        started_grid(chosen, "")
    assert str(caught.value) == (
        f"map.resolution is 0.05 m, but the cells of mapper.start_map {map_file} are 0.1 m: "
        "leave map.resolution out"
    )


@pytest.mark.parametrize(("given", "taken"), [(0.1 * (1 + 9e-7), True), (0.1 * (1 + 1.1e-6), False)])
def test_resolutions_that_differ_by_rounding_are_one(map_file, given, taken):
    chosen = settings_with(map_file, map={"resolution": given})
    if taken:
        assert started_grid(chosen, "").lattice.resolution == 0.1
    else:
        with pytest.raises(BadSetting, match=r"but the cells of mapper\.start_map"):
            started_grid(chosen, "")


@pytest.mark.parametrize(
    ("yaw", "degrees", "origin"),
    [
        ("0.1", "5.72958", (-1.05 - 0.3 * math.sin(0.1), 2.0)),
        ("3.14159265358979", "180", (-1.45, 1.7)),
        ("-1.5707963267949", "-90", (-1.05, 1.6)),
    ],
)
def test_a_map_that_is_turned_is_refused_and_how_to_turn_it_is_told(map_file, yaw, degrees, origin):
    """The new origin is the lower-left corner of what is around the turned map of 0.4 x 0.3 m."""
    map_file.write_text(map_file.read_text().replace("2.0, 0.0]", f"2.0, {yaw}]"))
    x, y = (f"{value:.6g}" for value in origin)
    with pytest.raises(BadMapFile) as caught:
        started_grid(settings_with(map_file), "")
    text = str(caught.value)
    assert text.startswith(f"{map_file}: origin: the map is turned by ")
    assert f"turn its picture counter-clockwise by {degrees} degrees" in text
    assert text.endswith(f"and set origin to [{x}, {y}, 0]")


def test_where_the_picture_was_found_is_told(map_file, caplog):
    map_file.write_text(map_file.read_text().replace('"floor.pgm"', "/home/someone/floor.pgm"))
    assert not started_grid(settings_with(map_file), "").snapshot().empty
    assert "there is no file '/home/someone/floor.pgm', so" in caplog.text


def test_what_was_not_given_stays_so_in_a_settings_file(map_file, tmp_path):
    config = tmp_path / "ogm.yaml"
    config.write_text(settings_with(map_file, map={"alpha": 0.2}).to_yaml())
    chosen = load_settings(config=config, flags={}, environ={})
    assert chosen.map.alpha == 0.2
    assert started_grid(chosen, "").lattice.resolution == 0.1


@pytest.mark.parametrize("given", [{"bounds": [-2, -2, 2, 2]}, {"preset": "lab"}])
def test_bounds_and_a_start_map_contradict_each_other(map_file, given):
    with pytest.raises(
        BadSetting, match=r"^map\.bounds: a map that starts with mapper\.start_map has no bounds"
    ):
        load_settings(config=None, flags={"map": given, "mapper": {"start_map": str(map_file)}}, environ={})


@pytest.mark.parametrize(
    ("limit", "says"),
    [
        ({"max_cells": 11}, "4 x 3 cells are more than max_cells = 11"),
        ({"max_bytes": 5000}, "max_bytes = 5000"),
    ],
)
def test_a_start_map_beyond_a_limit_is_refused(map_file, limit, says):
    with pytest.raises(BadSetting) as caught:
        started_grid(settings_with(map_file, mapper=limit), "")
    text = str(caught.value)
    assert text.startswith(f"mapper.start_map: {map_file}: ")
    assert says in text
    assert text.endswith("; raise the limit, or start with a smaller map")


def test_a_start_map_within_the_limits_is_taken(map_file):
    assert not started_grid(settings_with(map_file, mapper={"max_cells": 12}), "").snapshot().empty


def test_a_start_map_that_is_wrong_is_named(map_file):
    map_file.write_text(map_file.read_text().replace("trinary", "quaternary"))
    with pytest.raises(BadMapFile, match=r"floor\.yaml: mode: one of trinary, scale, raw is needed"):
        started_grid(settings_with(map_file), "")


# The command.


def complaint(*arguments):
    """What `ogm mapper` says when it refuses to start, in one line."""
    network = ("--listen", "tcp/127.0.0.1:0", "--http-port", "0")
    result = CliRunner().invoke(app, ["mapper", *map(str, arguments), *network], catch_exceptions=False)
    assert result.exit_code == 2, result.output
    assert result.stderr.count("\n") == 1
    return result.stderr


def test_the_command_refuses_bad_start_maps_in_one_line(map_file, tmp_path):
    assert "map.resolution is 0.2 m, but" in complaint("--start-map", map_file, "--resolution", "0.2")
    assert "mapper.start_confidence: with 0.7" in complaint(
        "--start-map", map_file, "--start-confidence", "0.7"
    )
    assert "map.bounds: " in complaint("--start-map", map_file, "--bounds", "-1,-1,1,1")
    assert "(--start-map)" in complaint("--start-map", tmp_path / "none.yaml")
    for confidence in ("0.5", "1", "nan", "sure"):
        assert "(--start-confidence)" in complaint("--start-confidence", confidence)
    (tmp_path / "floor.pgm").unlink()
    assert "floor.yaml: image: there is no file 'floor.pgm'" in complaint("--start-map", map_file)


# The service.


def test_a_mapper_serves_its_start_map_adds_to_it_and_forgets_it_at_a_reset(
    start_mapper, no_errors, map_file
):
    with start_mapper(mapper={"start_map": str(map_file)}) as mapper:
        served = mapper.http.get("/map.json").raise_for_status().json()
        assert (served["revision"], served["stamp"], served["resolution"]) == (0, None, 0.1)
        assert (served["anchor"], served["offset"]) == ([-1.05, 2.0], [0, 0])
        assert (served["width"], served["height"]) == (3, 2)
        assert served["data"] == [90, 10, 10, 10, 10, 90]
        before = mapper.http.get("/cell", params={"x": -1.0, "y": 2.05}).json()
        assert (before["known"], before["ix"], before["iy"]) == (True, 0, 0)
        assert before["log_odds"] == pytest.approx(math.log(9), abs=1e-3)
        assert mapper.http.get("/quality").json()["scans"] == 0
        # From cell (3, 0) west into the wall at (0, 0): two cells freer, one more occupied.
        mapper.scan([0.3], pose=[-0.7, 2.05, math.pi], range_max=8.0)
        assert mapper.settle(received=1)["revision"] == 1
        percent = json.loads(mapper.http.get("/map.json").content)["data"]
        assert percent[0] == round(100 * (9 * 7 / 3) / (1 + 9 * 7 / 3))
        assert percent[1] == round(100 * (3 / 7 / 9) / (1 + 3 / 7 / 9))
        assert percent[-1] == 90
        mapper.http.post("/reset").raise_for_status()
        emptied = mapper.http.get("/map.json").json()
        assert (emptied["width"], emptied["height"], emptied["revision"]) == (0, 0, 0)
        assert (emptied["anchor"], emptied["resolution"]) == ([-1.05, 2.0], 0.1)
        assert emptied["epoch"] != served["epoch"]


# There and back.


def check_round_trip(path, folder, **map_settings):
    """Start with a map, save it, read it: every cell has its class, at its place."""
    ros_map = read_ros_map(path)
    grid = started_grid(settings_with(path, map=map_settings), "")
    snapshot = grid.snapshot()
    (folder / "again.pgm").write_bytes(encode_pgm(snapshot))
    (folder / "again.yaml").write_bytes(encode_yaml(snapshot, "again.pgm"))
    again = read_ros_map(folder / "again.yaml")
    assert again.resolution == ros_map.resolution
    ix, iy = snapshot.offset
    assert again.origin == ros_map.lattice.corner_of(ix, iy)
    # What is saved is the smallest rectangle of known cells; all around it is unknown.
    expected = classes_of(ros_map.occupancy)
    height, width = again.occupancy.shape
    found = np.full_like(expected, -1)
    found[iy : iy + height, ix : ix + width] = again.occupancy
    assert np.array_equal(found, expected)
    outside = np.ones(expected.shape, np.bool_)
    outside[iy : iy + height, ix : ix + width] = False
    assert (ros_map.occupancy[outside] == -1).all()
    return ros_map, again


@pytest.mark.parametrize("cells", ["int16", "float64"])
@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_there_and_back_every_grey_keeps_its_class(tmp_path, mode, cells):
    greys = np.arange(256, dtype=np.uint8).reshape(16, 16)
    greys[0, 0], greys[-1, -1] = 20, 20  # known in every mode: the whole map is saved
    greys[0, -1], greys[-1, 0] = 0, 0
    (tmp_path / "in.pgm").write_bytes(write_pgm(greys))
    text = write_yaml("in.pgm", 0.03, (-12.3, 1 / 3)).replace("mode: trinary", f"mode: {mode}")
    (tmp_path / "in.yaml").write_text(text)
    ros_map, again = check_round_trip(tmp_path / "in.yaml", tmp_path, cells=cells)
    assert again.origin == ros_map.origin == (-12.3, 1 / 3)
    assert again.occupancy.shape == (16, 16)


@pytest.mark.parametrize("name", ["depot", "depot_keepout", "depot_speed", "tb3_sandbox", "warehouse"])
def test_there_and_back_maps_of_the_field_keep_every_class(ros_maps, tmp_path, name):
    assert name in {path.stem for path in ros_maps.glob("*.yaml")}
    check_round_trip(ros_maps / f"{name}.yaml", tmp_path)
