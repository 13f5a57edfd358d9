"""`MapGrid.plot`: what is drawn where, by the pixels of matplotlib's own renderer."""

import math
import sys

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from ogm_client import MapEmpty, MapGrid, MissingExtra
from ogm_client.plot import LARGEST, ROBOTS, UNKNOWN
from ogm_core.status import RobotStatus
from ogm_core.types import Pose

PROBABILITY = np.array([[math.nan, 0.9], [0.1, 0.5], [0.7, math.nan]])


def grid_of(probability, resolution=0.5, offset=(-2, 4)):
    with np.errstate(divide="ignore"):
        log_odds = np.log(probability / (1.0 - probability))
    return MapGrid(log_odds, resolution, (10.0, -20.0), offset, "e", 1, None)


@pytest.fixture
def ax():
    figure = Figure(figsize=(4.0, 4.0), dpi=100)
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def colour_at(ax, x, y):
    """What is drawn at a point, m: red, green, blue, 0 to 1."""
    ax.figure.canvas.draw()
    pixels = np.asarray(ax.figure.canvas.buffer_rgba())
    column, row = ax.transData.transform((x, y))
    return tuple(pixels[pixels.shape[0] - 1 - int(row), int(column), :3] / 255.0)


def test_every_cell_is_drawn_where_it_lies(ax):
    grid = grid_of(PROBABILITY)
    assert grid.plot(ax) is ax
    assert (ax.get_xlim(), ax.get_ylim()) == ((9.0, 10.0), (-18.0, -16.5))
    for (iy, ix), p in np.ndenumerate(PROBABILITY):
        x, y = 9.0 + 0.5 * (ix + 0.5), -18.0 + 0.5 * (iy + 0.5)
        expected = to_rgb(UNKNOWN) if math.isnan(p) else (1.0 - p,) * 3
        for dx, dy in ((0.0, 0.0), (-0.23, -0.23), (0.23, 0.23)):
            assert colour_at(ax, x + dx, y + dy) == pytest.approx(expected, abs=0.01), (ix, iy)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x (m)", "y (m)")
    assert ax.get_aspect() == 1.0


def test_robots_are_where_they_were_last_and_those_that_are_gone_are_not(ax):
    robots = {
        "here": RobotStatus(Pose(9.25, -17.25, 0.0), 1, alive=True),
        "gone": RobotStatus(Pose(9.75, -17.25, 0.0), 1, alive=False, age_s=100.0),
        "nowhere": RobotStatus(None, None, alive=True),
        "$later$": RobotStatus(Pose(9.75, -16.75, 0.0), 1, alive=True),
    }
    grid_of(PROBABILITY).plot(ax, robots=robots)
    assert colour_at(ax, 9.25, -17.25) == pytest.approx(to_rgb(ROBOTS[2]), abs=0.02)
    assert colour_at(ax, 9.75, -17.25) == pytest.approx((0.5, 0.5, 0.5), abs=0.01)
    assert {text.get_text() for text in ax.texts} == {"", "here", "$later$"}
    assert (ax.get_xlim(), ax.get_ylim()) == ((9.0, 10.0), (-18.0, -16.5))


def test_a_robots_arrow_points_where_it_looks(ax):
    robots = {"r": RobotStatus(Pose(9.5, -17.25, math.pi / 2), 1, alive=True)}
    grid_of(np.full((3, 2), 0.001)).plot(ax, robots=robots)
    metres = 100 / 72 * 9.0 / (ax.transData.transform((1.0, 0.0)) - ax.transData.transform((0.0, 0.0)))[0]
    red = colour_at(ax, 9.5, -17.25 + metres)[0]
    assert red < 0.5
    for x, y in ((9.5 + metres, -17.25), (9.5 - metres, -17.25), (9.5, -17.25 - metres)):
        assert colour_at(ax, x, y)[0] > 0.9


def test_a_large_map_is_shrunk_and_keeps_its_place(ax):
    probability = np.full((3, LARGEST + 2), math.nan)
    probability[2, 0], probability[0, -1] = 0.9, 0.1
    grid_of(probability, resolution=0.5, offset=(0, 0)).plot(ax)
    (image,) = ax.images
    assert image.get_array().shape == (2, LARGEST // 2 + 1)
    assert tuple(image.get_extent()) == (10.0, 10.0 + (LARGEST + 2) * 0.5, -20.0, -18.0)


def test_without_axes_it_draws_into_pyplots_own(monkeypatch):
    pyplot.switch_backend("agg")
    try:
        figure, axes = pyplot.subplots()
        assert grid_of(PROBABILITY).plot() is axes
        assert len(axes.images) == 1
        pyplot.close(figure)
    finally:
        pyplot.close("all")


def test_an_empty_map_and_a_missing_matplotlib_are_said(ax, monkeypatch):
    with pytest.raises(MapEmpty, match="no known cell"):
        grid_of(np.empty((0, 0))).plot(ax)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtra, match="pip install matplotlib"):
        grid_of(PROBABILITY).plot()
