"""A mapper that goes on with a map.npz: value for value what was saved, and what contradicts it."""

import io
import math

import numpy as np
import pytest

from ogm_client import MapGrid
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadMapFile, BadSetting
from ogm_core.files.map_files import encode_npz, read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live import start_map
from ogm_services.mapper.live.start_map import started_grid
from ogm_services.settings.settings import Settings

ODD = {"p_prior": 0.3, "p_free": 0.2, "p_occ": 0.8, "l_min": -4.0, "l_max": 6.0}
MODELS = [{}, {"cells": "float64"}, ODD, {"cells": "float64", **ODD}, {"l_min": -30.0, "l_max": 30.0}]
LAB = {"cells": "float64", "resolution": 0.1, "bounds": [-10, -10, 10, 10], "outside": "drop", "alpha": 0.2}


def scans(count, seed=3):
    """Scans from places around (5, -3): free cells, walls seen often, cells brought back to the prior."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        ranges = rng.uniform(0.5, 4.0, 90).astype(np.float32)
        ranges[::7] = math.inf
        yield Scan(k, -3.0, 0.07, 0.0, 6.0, ranges), Pose(5.0 + rng.normal(), -3.0 + rng.normal(), float(k))


def mapped(settings, count=40):
    grid = OccupancyGrid(settings.grid_settings(), "before")
    for scan, pose in scans(count):
        grid.integrate(scan, pose)
    return grid


def settings_with(path=None, mapper=(), **changes):
    started = {} if path is None else {"start_map": str(path)}
    return Settings.model_validate({"map": changes, "mapper": started | dict(mapper)})


def saved(grid, folder):
    path = folder / "map.npz"
    path.write_bytes(encode_npz(grid.snapshot()))
    return path


def check_equal(left, right):
    """Two npz files hold the same, bit for bit but for the sign of a zero."""
    one, two = read_npz(left), read_npz(right)
    assert one.log_odds.dtype == two.log_odds.dtype
    np.testing.assert_array_equal(one.log_odds, two.log_odds)
    assert (one.resolution, one.anchor, one.offset) == (two.resolution, two.anchor, two.offset)


@pytest.mark.parametrize("changes", [*MODELS, LAB], ids=range(6))
def test_a_map_goes_on_as_if_it_had_never_been_saved(tmp_path, changes):
    """What is served at the start is what was saved; so is, after more scans, what is served then."""
    settings = settings_with(**changes)
    grid = mapped(settings)
    path = saved(grid, tmp_path)
    again = started_grid(settings_with(path, **changes), "after")
    check_equal(encode_npz(again.snapshot()), path.read_bytes())
    assert (again.epoch, again.revision, again.stamp) == ("after", 0, None)
    assert again.snapshot().known_cells == grid.snapshot().known_cells > 500
    for scan, pose in scans(30, seed=4):
        assert again.integrate(scan, pose) == grid.integrate(scan, pose)
    check_equal(encode_npz(again.snapshot()), encode_npz(grid.snapshot()))


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_every_value_that_a_cell_can_have_comes_back(tmp_path, cells):
    model = LogOdds(cells)
    every = np.arange(-16383, 16384).reshape(7, -1) * model.step if cells == "int16" else None
    log_odds = (
        np.random.default_rng(1).uniform(-8, 8, (50, 60)) if every is None else every.astype(np.float32)
    )
    log_odds[1, ::5] = math.nan
    log_odds[2, 7] = 0.0  # brought back to the prior: known
    path = tmp_path / "every.npz"
    MapGrid(log_odds, 0.05, (1.5, -2.0), (-7, 40), "e", 3, 5).save_npz(path)
    check_equal(encode_npz(started_grid(settings_with(path, cells=cells), "").snapshot()), path.read_bytes())


def test_a_mapper_serves_what_it_starts_with(start_mapper, no_errors, tmp_path):
    path = saved(mapped(settings_with()), tmp_path)
    with start_mapper(mapper={"start_map": str(path)}) as mapper:
        served = mapper.http.get("/map.npz").raise_for_status().content
        check_equal(served, path.read_bytes())
        assert mapper.status()["revision"] == 0
        with np.load(io.BytesIO(served)) as one, np.load(path) as two:
            assert sorted(one) == sorted(two)
            assert all(np.array_equal(one[name], two[name], equal_nan=True) for name in one)


def test_a_map_without_a_cell_is_an_empty_start(tmp_path):
    path = saved(OccupancyGrid(GridSettings()), tmp_path)
    assert started_grid(settings_with(path), "").snapshot().empty


def test_a_part_of_a_map_lies_where_it_lay(tmp_path):
    whole = mapped(settings_with()).snapshot()
    path = tmp_path / "part.npz"
    path.write_bytes(encode_npz(whole.crop(Region(5.0, -3.0, 6.0, -2.0))))
    snapshot = started_grid(settings_with(path), "").snapshot()
    part = whole.crop(Region(*snapshot.origin, *(c + 1e-9 for c in snapshot.lattice.corner_of(
        snapshot.offset[0] + snapshot.width, snapshot.offset[1] + snapshot.height))))  # fmt: skip
    check_equal(encode_npz(snapshot), encode_npz(part))


def refused(settings, kind=BadSetting):
    with pytest.raises(kind) as caught:
        started_grid(settings, "")
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_settings_that_contradict_it_are_refused(tmp_path):
    path = saved(mapped(settings_with(**ODD)), tmp_path)
    assert refused(settings_with(path, **ODD, resolution=0.1)).startswith(
        f"map.resolution is 0.1 m, but the cells of mapper.start_map {path} are 0.05 m: "
    )
    assert (
        started_grid(settings_with(path, **ODD, resolution=0.05 * (1 + 9e-7)), "").lattice.resolution == 0.05
    )
    assert refused(settings_with(path, **ODD, cells="float64")).endswith("int16 cells: give --cells int16")
    for other in ({"p_prior": 0.31}, {"l_min": -9.0}, {"l_max": 6.5}, {"l_max": 1.0}):
        text = refused(settings_with(path, **ODD | other))
        assert text.startswith(
            f"mapper.start_map: {path} was saved with another map.p_prior, map.l_min or map.l_max: the log "
        )
        assert " cells in all): give those that it was saved with" in text
    # What is added by a scan may change: that is no matter of what is there.
    assert not started_grid(settings_with(path, **ODD | {"p_occ": 0.9, "p_free": 0.1}), "").snapshot().empty
    assert refused(settings_with(path, **ODD, mapper={"start_confidence": 0.8})).startswith(
        f"mapper.start_confidence: {path} has its cells' log odds"
    )
    text = refused(settings_with(path, **ODD, mapper={"max_cells": 9}))
    assert text.startswith(f"mapper.start_map: {path}: ")
    assert text.endswith("cells are more than max_cells = 9; raise the limit, or start with a smaller map")


def test_a_map_may_be_as_large_as_the_mapper_s_limit_says(tmp_path, monkeypatch):
    monkeypatch.setattr(start_map, "MAX_NPZ_BYTES", 1000)
    grid = mapped(settings_with(**ODD))
    path, cells = saved(grid, tmp_path), grid.snapshot().width * grid.snapshot().height
    assert started_grid(settings_with(path, **ODD, mapper={"max_cells": cells}), "e").revision == 0
    text = refused(settings_with(path, **ODD, mapper={"max_cells": cells // 8}), BadMapFile)
    assert f"its cells take {4 * cells} bytes, at most {cells // 8 * 8} are allowed" in text


def test_float64_cells_keep_their_log_odds_under_another_prior(tmp_path):
    """The prior is that of cells to come; only clamps would change what is there."""
    grid = mapped(settings_with(cells="float64"))
    path = saved(grid, tmp_path)
    again = started_grid(settings_with(path, cells="float64", p_prior=0.4), "")
    check_equal(encode_npz(again.snapshot()), path.read_bytes())
    assert "would become 1 (" in refused(settings_with(path, cells="float64", l_max=1.0))
    assert "map.cells is int16, but" in refused(settings_with(path))


def test_bounds_are_those_of_the_map_that_was_saved(tmp_path):
    path = saved(mapped(settings_with(**LAB)), tmp_path)
    again = started_grid(settings_with(path, **LAB), "")
    assert (again.rect.width, again.rect.height) == (200, 200)
    wider = started_grid(settings_with(path, **LAB | {"bounds": [-10, -10, 12, 10]}), "")
    assert (wider.rect.width, wider.rect.height) == (220, 200)
    assert not started_grid(settings_with(path, **LAB | {"bounds": None}), "").snapshot().empty
    assert refused(settings_with(path, **LAB | {"bounds": [-12, -10, 10, 10]})).startswith(
        "map.bounds: they begin at (-12.0, -10.0), and the cells of mapper.start_map"
    )
    assert "are not all within the bounds (mapper.start_map" in refused(
        settings_with(path, **LAB | {"bounds": [-10, -10, 8, 10]})
    )


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not a map that was saved here and can be read"),
        (b"image: map.pgm\n", "not a map that was saved here and can be read"),
        (None, "not a map that was saved here and can be read (\"There is no item named 'resolution.npy'"),
    ],
)
def test_a_file_that_is_no_map_is_refused(tmp_path, content, says):
    path = tmp_path / "other.NPZ"
    if content is None:
        file = io.BytesIO()
        np.savez(file, log_odds=np.zeros((2, 2), np.float32))
        content = file.getvalue()
    path.write_bytes(content)
    text = refused(settings_with(path), BadMapFile)
    assert text.startswith(f"{path}: {says}")
    with pytest.raises(BadMapFile) as caught:
        MapGrid.load(path)
    assert str(caught.value) == text


@pytest.mark.parametrize(
    "changes", [{}, {"bounds": [-1, -9, 11, 3], "outside": "drop"}], ids=["unbounded", "bounded"]
)
def test_a_map_of_counts_goes_on_as_if_it_had_never_been_saved(tmp_path, changes):
    counts = {"cell_model": "rate", "resolution": 0.1, **changes}
    grid = mapped(settings_with(**counts), 5)
    path = tmp_path / "map.npz"
    path.write_bytes(encode_npz(grid.snapshot().finest()))
    again = started_grid(settings_with(path, **counts), "after")
    assert encode_npz(again.snapshot().finest()) == path.read_bytes()
    for scan, pose in scans(5, seed=4):
        assert again.integrate(scan, pose) == grid.integrate(scan, pose)
    assert encode_npz(again.snapshot()) == encode_npz(grid.snapshot())


def test_a_map_of_another_cell_model_is_refused(tmp_path):
    for saved_as, given in (("rate", "log_odds"), ("log_odds", "rate")):
        path = saved(mapped(settings_with(cell_model=saved_as), 1), tmp_path)
        with pytest.raises(BadSetting) as error:
            started_grid(settings_with(path, cell_model=given), "")
        assert str(error.value) == (
            f"map.cell_model is {given}, but mapper.start_map {path} was saved by a map of {saved_as} cells: "
            f"give --cell-model {saved_as}"
        )
