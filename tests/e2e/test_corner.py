"""The picture of one corner in two maps, as README.md shows it."""

import numpy as np
import pytest
from PIL import Image

from docs import corner
from ogm_client import MapGrid


@pytest.mark.parametrize("occupied", [0, 1])
def test_each_half_is_of_its_own_map_and_of_that_corner(tmp_path, occupied):
    xmin, ymin, xmax, ymax = corner.CORNER
    for side, resolution in enumerate(
        (0.5, 0.25)
    ):  # free, and a block in one of them, south-west of the middle
        width, height = (int((end - start) / resolution) + 8 for start, end in ((xmin, xmax), (ymin, ymax)))
        cells = np.full((height, width), -5.0)
        if side == occupied:
            cells[4 : 4 + int(2.5 / resolution), 4 : 4 + int(2.5 / resolution)] = 5.0
        offset = int(xmin / resolution) - 4, int(ymin / resolution) - 4
        folder = tmp_path / str(side)
        folder.mkdir()
        MapGrid(cells, resolution, (0.0, 0.0), offset, "e", 1, None).save_npz(folder / "map.npz")
    corner.main(str(tmp_path / "0"), str(tmp_path / "1"), picture=str(tmp_path / "corner.png"))
    with Image.open(tmp_path / "corner.png") as picture:
        dark = np.asarray(picture.convert("L"))[40:] < 64  # below the titles
    middle, half = dark.shape[0] // 2, dark.shape[1] // 2
    halves = dark[:, :half], dark[:, half:]
    assert not halves[1 - occupied].any()
    south_west = halves[occupied][middle + 20 :, : half // 2 - 40]
    assert south_west[20:-20, 40:].mean() > 0.9
    assert not halves[occupied][: middle - 40].any()
    assert not halves[occupied][:, half // 2 + 20 :].any()
