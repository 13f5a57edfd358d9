"""The figure of a map: what its pixels and its texts show."""

import io
import math
import subprocess
import sys
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from PIL import Image

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.simulation.trajectories import CirclePath
from ogm_core.simulation.worlds import World, lab
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import Pose, Scan
from ogm_services.results.driven_paths import DrivenPath
from ogm_services.results.figure import OBSTACLES, ROBOTS, UNKNOWN, describe, draw_map, encode_figure

NAN = math.nan


def rgb(colour):
    return tuple(bytes.fromhex(colour[1:]))


def snapshot_of(p, *, resolution=0.5, anchor=(0.0, 0.0), offset=(0, 0), revision=3):
    """A map of these probabilities, NaN where unknown; rows from the north, as one reads."""
    p = np.array(p, float)[::-1]
    known = ~np.isnan(p)
    model = LogOdds("float64", l_min=-20.0, l_max=20.0)
    cells = model.store(np.log(np.where(known, p, 0.5) / (1 - np.where(known, p, 0.5))), known)
    return MapSnapshot(
        CellArrays.of(model, cells), model, Lattice(resolution, anchor), offset, "e", revision, 1
    )


def world_of(circles=(), walls=()):
    return World(
        "w",
        np.array(circles, float).reshape(-1, 3),
        np.array(walls, float).reshape(-1, 4),
        CirclePath(0.0, 0.0, 1.0, 4),
    )


def path_of(*points):
    path = DrivenPath()
    for x, y in points:
        path.add(Scan(0, 0.0, 0.1, 0.0, 9.0, np.ones(1, np.float32)), Pose(x, y, 0.0))
    return path


class Drawn:
    """A drawn map: its figure, its axes, and the pixels of its PNG."""

    def __init__(self, snapshot, name="a.log", description="one map", world=None, paths=None):
        self.figure = draw_map(snapshot, name, description, world, paths or {})
        self.main, self.bar = self.figure.axes
        with Image.open(io.BytesIO(encode_figure(self.figure, "png"))) as picture:
            assert picture.format == "PNG"
            assert picture.info["dpi"] == pytest.approx((300, 300), abs=0.1)
            self.pixels = np.asarray(picture.convert("RGB")).astype(int)
        box = self.main.get_position()
        self.width, self.height = (round(inches * 300) for inches in self.figure.get_size_inches())
        assert self.pixels.shape == (self.height, self.width, 3)
        self.left, self.bottom = box.x0 * self.width, box.y0 * self.height
        self.view = (*self.main.get_xlim(), *self.main.get_ylim())
        self.scale = box.width * self.width / (self.view[1] - self.view[0])
        assert box.height * self.height / (self.view[3] - self.view[2]) == pytest.approx(self.scale)

    def place(self, x, y):
        """Column and row, with fractions, of a point in metres."""
        return (
            self.left + (x - self.view[0]) * self.scale,
            self.height - (self.bottom + (y - self.view[2]) * self.scale),
        )

    def at(self, x, y):
        """Colour at a point in metres."""
        column, row = self.place(x, y)
        return tuple(self.pixels[math.floor(row), math.floor(column)])

    def square(self, x, y, size):
        """Every pixel of a square whose lower-left corner is (x, y), m; its edges lie between pixels."""
        left, bottom = self.place(x, y)
        right, top = self.place(x + size, y + size)
        for edge in (left, bottom, right, top):
            assert edge == pytest.approx(round(edge), abs=1e-6)
        return self.pixels[round(top) : round(bottom), round(left) : round(right)]

    def count(self, colour):
        """How many pixels have a colour, outside the legend."""
        inside = self.pixels[: round(self.height - self.bottom)]
        return int((inside == colour).all(axis=2).sum())

    def texts(self):
        """What is written above and below."""
        return [text.get_text() for text in self.figure.texts]

    def legend(self):
        return [text.get_text() for text in self.figure.legends[0].get_texts()]


def test_every_cell_is_a_square_of_its_grey_with_north_up():
    p = np.array([[0.0001, 0.1, NAN], [0.5, 0.9, 0.9999]])
    drawn = Drawn(snapshot_of(p, resolution=0.1, anchor=(-3.7, 2.1), offset=(-2, 5)))
    for (row, column), value in np.ndenumerate(p[::-1]):
        square = drawn.square(-3.7 + (column - 2) * 0.1, 2.1 + (row + 5) * 0.1, 0.1)
        assert min(square.shape[:2]) > 100
        expected = rgb(UNKNOWN) if math.isnan(value) else (round(255 * (1 - value)),) * 3
        assert np.abs(square[1:-1, 1:-1] - expected).max() <= 2, (row, column)
    around = drawn.square(-3.7 - 3 * 0.1, 2.1 + 5 * 0.1, 0.1)
    assert (around[:, 5:] == rgb(UNKNOWN)).all()  # the axes' line is at its edge


def test_cells_of_a_large_map_are_whole_pixels_too():
    rng = np.random.default_rng(0)
    p = rng.choice([0.1, 0.9], (300, 407))
    drawn = Drawn(snapshot_of(p))
    columns, rows = np.meshgrid(np.arange(407), np.arange(300))
    for column, row in zip(columns[::7, ::11].ravel(), rows[::7, ::11].ravel(), strict=True):
        square = drawn.square(column * 0.5, row * 0.5, 0.5)
        assert square.shape == (4, 4, 3)
        assert np.abs(square - 255 * (1 - p[::-1][row, column])).max() <= 2


def test_axes_in_metres_colour_bar_title_and_legend():
    drawn = Drawn(
        snapshot_of(np.full((40, 80), 0.2)),
        "walk.jsonl",
        "3 scans",
        lab(),
        {"robot1": path_of((1, 1), (2, 2))},
    )
    assert (drawn.main.get_xlabel(), drawn.main.get_ylabel()) == ("x (m)", "y (m)")
    assert drawn.main.get_aspect() == 1.0
    assert drawn.view == pytest.approx((-1.0, 41.0, -1.0, 21.0))  # 2 % of 80 cells, rounded up to 2
    assert np.diff(drawn.main.get_xticks()) == pytest.approx(5.0)
    assert np.diff(drawn.main.get_yticks()) == pytest.approx(5.0)
    assert drawn.bar.get_ylabel() == "p(occupied)"
    assert drawn.bar.get_yticks() == pytest.approx([0, 0.25, 0.5, 0.75, 1])
    assert drawn.texts() == ["walk.jsonl", "3 scans"]
    assert drawn.legend() == ["unknown", "true obstacles", "path of robot1"]


def test_the_colour_bar_is_black_at_one_and_white_at_zero():
    drawn = Drawn(snapshot_of([[0.2]]))
    box = drawn.bar.get_position()
    column = round((box.x0 + box.x1) / 2 * drawn.width)
    top, bottom = (round((1 - y) * drawn.height) for y in (box.y1, box.y0))
    greys = drawn.pixels[top + 5 : bottom - 5, column]
    assert (greys[0] <= 3).all()
    assert (greys[-1] >= 252).all()
    assert (np.diff(greys[:, 0]) >= 0).all()
    assert abs(greys[len(greys) // 2, 0] - 128) <= 2


def test_obstacles_are_outlines_in_their_place():
    free = snapshot_of(np.full((60, 100), 0.001), resolution=0.1, offset=(-50, -30))
    world = world_of([(2.0, 1.0, 1.5)], [(-4.0, -2.0, 0.0, 2.0), (-4.5, 2.5, -4.5, -2.5)])
    drawn = Drawn(free, world=world)
    turns = np.linspace(0.1, 6.3, 40)
    on_circle = [(2.0 + 1.5 * math.cos(turn), 1.0 + 1.5 * math.sin(turn)) for turn in turns]
    on_walls = [(-4.0 + 4 * t, -2.0 + 4 * t) for t in np.linspace(0.01, 0.99, 40)]
    for x, y in [*on_circle, *on_walls]:
        column, row = (math.floor(value) for value in drawn.place(x, y))
        near = drawn.pixels[row - 1 : row + 2, column - 1 : column + 2].reshape(-1, 3)
        assert np.abs(near - rgb(OBSTACLES)).sum(axis=1).min() < 60, (x, y)
    assert drawn.at(2.0, 1.0) == (255, 255, 255)  # outlines only
    assert drawn.at(0.1, 2.1) == (255, 255, 255)  # the wall ends
    # A line is 0.5 pt wide: two pixels.
    assert drawn.count(rgb(OBSTACLES)) > 5.0 * drawn.scale * 1.5
    assert Drawn(free).count(rgb(OBSTACLES)) == 0
    assert Drawn(free).legend() == ["unknown"]


def test_obstacles_far_away_are_left_out_and_huge_ones_are_no_trouble():
    free = snapshot_of(np.full((60, 100), 0.001), resolution=0.1)
    far = world_of([(50.0, 3.0, 2.0)], [(-9.0, -9.0, -5.0, 20.0)])
    drawn = Drawn(free, world=far)
    assert drawn.main.patches[0].get_path().vertices.size == 0
    assert drawn.count(rgb(OBSTACLES)) == 0
    huge = world_of([(1e6, 3.0, 1e6 - 5.0)], [(-1e6, 2.0, 1e6, 2.0)])
    drawn = Drawn(free, world=huge)
    for x in np.linspace(0.5, 9.5, 19):
        assert np.abs(np.subtract(drawn.at(x, 2.0), rgb(OBSTACLES))).sum() < 60
    assert drawn.count(rgb(OBSTACLES)) > 10 * drawn.scale


def test_paths_of_robots_have_colours_of_their_own():
    free = snapshot_of(np.full((60, 100), 0.001), resolution=0.1)
    paths = {"b": path_of((1, 1), (3, 1), (5, 1)), "a": path_of((1, 4), (5, 4), (9.9, 4), (9.9, 1))}
    drawn = Drawn(free, paths=paths)
    for x in np.linspace(1.1, 4.9, 20):
        assert np.abs(np.subtract(drawn.at(x, 1.0), rgb(ROBOTS[0]))).sum() < 60
        assert np.abs(np.subtract(drawn.at(x, 4.0), rgb(ROBOTS[1]))).sum() < 60
    assert drawn.at(5.3, 1.0) == (255, 255, 255)
    beside = 1.0 + 4 / drawn.scale
    assert drawn.at(1.0, beside) == rgb(ROBOTS[0])  # the dot where it begins
    assert drawn.at(5.0, beside) == drawn.at(3.0, beside) == (255, 255, 255)
    assert drawn.legend() == ["unknown", "path of b", "path of a"]


def test_the_legend_names_a_few_of_many_robots_and_fits():
    free = snapshot_of(np.full((60, 100), 0.001), resolution=0.1)
    names = [f"robot_{k}" + "x" * 50 for k in range(20)]
    drawn = Drawn(free, paths={name: path_of((k / 3, 1), (k / 3, 4)) for k, name in enumerate(names)})
    written = drawn.legend()
    assert written[1] == "path of robot_0xxxxxxxxxxxxxxxx…"
    assert (len(written), written[-1]) == (8, "and 14 more")
    box = drawn.figure.legends[0].get_window_extent()
    assert 0 <= box.x0 < box.x1 <= drawn.width
    assert 0 <= box.y0 < box.y1 < drawn.bottom - 60  # clear of the axis' numbers
    assert drawn.count(rgb(ROBOTS[13 % len(ROBOTS)])) > 0


@pytest.mark.parametrize("shape", [(1, 1), (3, 900), (900, 3), (120, 140), (2000, 70)])
def test_texts_stay_in_the_picture_and_beside_each_other(shape):
    name = "the log of a long day in $\\building$ with ünïcödé, 地図\n and more" * 3
    drawn = Drawn(
        snapshot_of(np.full(shape, 0.3)), name, "123456 scans, resolution 0.05 m, model " * 2, lab()
    )
    boxes = [text.get_window_extent() for text in drawn.figure.texts]
    boxes += [drawn.main.get_tightbbox(), drawn.bar.get_tightbbox()]
    for box in boxes:
        assert 0 <= box.x0 < box.x1 <= drawn.width
        assert 0 <= box.y0 < box.y1 <= drawn.height
    title, description, axes, bar = boxes
    assert title.y0 >= description.y1 - 2
    assert description.y0 > axes.y1 - 30
    assert axes.x1 < bar.x0 + 30
    assert drawn.texts()[0].startswith("the log of a long day in $\\")
    assert "\n" not in drawn.texts()[0]
    # A narrow map leaves room for the title, a low one for the bar.
    inside = drawn.main.get_position()
    assert inside.width * drawn.width >= 1049
    assert inside.height * drawn.height >= 599


def test_a_large_map_is_shrunk_so_that_occupied_wins():
    p = np.full((2000, 4100), 0.1)
    p[1234, 56] = 0.9
    drawn = Drawn(snapshot_of(p, resolution=0.05), description="3 scans")
    assert max(drawn.width, drawn.height) < 2600
    assert drawn.view == pytest.approx((-4.2, 209.25, -4.2, 104.25))  # 28 blocks of 0.15 m around 1367 x 667
    assert drawn.texts()[1] == "3 scans, drawn in blocks of 0.15 m"
    x, y = 56.5 * 0.05, (1999 - 1234 + 0.5) * 0.05
    assert max(drawn.at(x, y)) < 30
    assert min(drawn.at(x + 0.3, y)) > 225


def test_what_a_map_was_made_with():
    snapshot = snapshot_of([[0.2]], resolution=0.05, revision=220)
    assert (
        describe(snapshot, GridSettings()) == "220 scans, resolution 0.05 m, model beam, traversal bresenham"
    )
    assert describe(snapshot, GridSettings(traversal="dda")).endswith("model beam, traversal dda")
    one = snapshot_of([[0.2]], resolution=0.1, revision=1)
    assert describe(one, GridSettings(sensor_model="sector")) == "1 scan, resolution 0.1 m, model sector"


def drawing():
    return draw_map(snapshot_of([[0.2, 0.9]]), "a.log", "one map", lab(), {"r": path_of((0, 0), (1, 0))})


@pytest.mark.parametrize(("form", "head"), [("png", b"\x89PNG\r\n"), ("pdf", b"%PDF-1."), ("svg", b"<?xml")])
def test_formats_and_equal_bytes_whatever_the_users_style(form, head):
    content = encode_figure(drawing(), form)
    assert content.startswith(head)
    before = dict(mpl.rcParams)
    with mpl.rc_context(
        {"font.size": 30.0, "axes.facecolor": "red", "savefig.dpi": 50, "lines.linewidth": 9}
    ):
        assert encode_figure(drawing(), form) == content
    assert dict(mpl.rcParams) == before


def test_pdf_and_svg_hold_lines_and_letters_not_pixels():
    svg = ElementTree.fromstring(encode_figure(drawing(), "svg"))
    shapes = "".join(ElementTree.tostring(svg, encoding="unicode"))
    assert OBSTACLES in shapes
    assert ROBOTS[0] in shapes
    assert len(list(svg.iter("{http://www.w3.org/2000/svg}image"))) <= 2  # the cells, the colour bar
    pdf = encode_figure(drawing(), "pdf")
    assert b"/FontFile2" in pdf  # TrueType, as publishers want it
    assert b"CreationDate" not in pdf


def test_matplotlib_is_loaded_for_figures_only_and_without_pyplot():
    code = (
        "import sys, ogm_services.commands.build, ogm_services.cli\n"
        "assert 'matplotlib' not in sys.modules\n"
        "import ogm_services.results.figure as figure, numpy as np\n"
        "from ogm_core.snapshot import MapSnapshot\n"
        "from ogm_core.cells.log_odds import LogOdds\n"
        "from ogm_core.cells.arrays import CellArrays\n"
        "from ogm_core.lattice import Lattice\n"
        "cells = CellArrays({'log_odds': np.full((2, 2), 1.5)})\n"
        "snapshot = MapSnapshot(cells, LogOdds('float64'), Lattice(1.0), (0, 0), 'e', 1, 1)\n"
        "figure.encode_figure(figure.draw_map(snapshot, 'a', 'b', None, {}), 'png')\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300)
