"""Maps of counts that are saved and read again."""

import io

import numpy as np
import pytest

from ogm_core.cells.classes import trinary
from ogm_core.cells.rate import PLANES, Rate
from ogm_core.errors import BadMapFile
from ogm_core.files.counted_maps import load_counts
from ogm_core.files.map_files import encode_npz, read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.types import Pose, Scan


@pytest.fixture(scope="module")
def grid():
    rng = np.random.default_rng(2)
    grid = OccupancyGrid(GridSettings(resolution=0.1, cell_model=Rate(), anchor=(0.3, -0.2)), "e")
    for k in range(5):
        scan = Scan(k, -3.0, 0.07, 0.0, 6.0, rng.uniform(0.5, 4.0, 90).astype(np.float32))
        grid.integrate(scan, Pose(*rng.uniform(-3.0, 3.0, 3)))
    return grid


def load(path, content):
    path.write_bytes(content)
    return load_counts(path, PLANES, max_bytes=10**7)


@pytest.mark.parametrize("finest", [False, True])
def test_planes_and_log_odds_are_saved(grid, tmp_path, finest):
    whole = grid.snapshot()
    snapshot = whole.finest() if finest else whole
    found = load(tmp_path / "map.npz", encode_npz(snapshot))
    assert (found.resolution, found.anchor, found.offset) == (0.1, (0.3, -0.2), whole.offset)
    for name, cells in whole.stored.planes().items():
        assert found.planes[name].dtype == cells.dtype
        assert np.array_equal(found.planes[name], cells)
    p, known = snapshot.published()
    served = read_npz((tmp_path / "map.npz").read_bytes())
    assert (served.resolution, served.offset) == (snapshot.resolution, snapshot.offset)
    assert np.array_equal(np.isnan(served.log_odds), ~known)
    read = 1 / (1 + np.exp(-served.log_odds[known].astype(float)))
    assert np.array_equal(trinary(read, True), trinary(p[known], True))
    assert np.count_nonzero(p == 0.65) > 10
    p = np.clip(p, 1e-9, 1 - 1e-9)[known]
    np.testing.assert_allclose(served.log_odds[known], np.log(p / (1 - p)), rtol=1e-6)


def test_a_part_of_halves_has_the_planes_of_the_cells_that_it_meets(grid, tmp_path):
    whole = grid.snapshot()
    fine = whole.finest()
    x, y = fine.origin
    part = fine.crop(Region(x + 0.16, y + 0.36, x + 1.24, y + 1.04))
    assert (part.offset[0] - fine.offset[0], part.width, part.height) == (3, 22, 14)
    found = load(tmp_path / "map.npz", encode_npz(part))
    assert found.offset == (whole.offset[0] + 1, whole.offset[1] + 3)
    assert np.array_equal(found.planes["N"], whole.stored.planes()["N"][3:11, 1:13])
    assert np.array_equal(found.planes["H"], whole.stored.planes()["H"][6:22, 2:26])


def test_a_map_of_log_odds_has_no_counts(tmp_path):
    snapshot = OccupancyGrid(GridSettings(bounds=Region(0.0, 0.0, 1.0, 1.0)), "e").snapshot()
    assert load(tmp_path / "map.npz", encode_npz(snapshot)) is None


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"per_cell": np.array(3)}, "per_cell is 3, 1 or 2 is needed"),
        ({"per_cell": np.array([2])}, "per_cell is int64 of shape (1,), one whole number is needed"),
        ({"E": np.zeros((4, 4), np.uint32)}, "E is uint32 of shape (4, 4), uint32 of shape"),
        ({"N": np.zeros((4, 4))}, "N is float64 of shape (4, 4), uint16 of shape (4, 4) is needed"),
        ({"H": None}, "not a map that was saved here"),
        ({"offset": np.array([2**60, 0])}, "offset is"),
    ],
)
def test_what_is_no_map_of_counts_is_refused(grid, tmp_path, changes, says):
    with np.load(io.BytesIO(encode_npz(grid.snapshot()))) as file:
        arrays = dict(file) | changes
    content = io.BytesIO()
    np.savez(content, **{name: array for name, array in arrays.items() if array is not None})
    with pytest.raises(BadMapFile) as error:
        load(tmp_path / "map.npz", content.getvalue())
    assert says in str(error.value)


def test_more_than_may_be_read_is_refused(grid, tmp_path):
    path = tmp_path / "map.npz"
    path.write_bytes(encode_npz(grid.snapshot()))
    with pytest.raises(BadMapFile, match=r"its planes take .* bytes, at most 1000 are allowed"):
        load_counts(path, PLANES, max_bytes=1000)
