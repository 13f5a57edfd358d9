"""The examples, each run as its own text says, against a real mapper: what they send, show and save."""

import ast
import io
import json
import math
import os
import re
import runpy
import signal
import subprocess
import sys
import time
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import yaml
from PIL import Image

from ogm_client import MapClient, Ray
from ogm_core.simulation.lidar import Lidar, true_ranges
from ogm_core.simulation.worlds import load_world
from ogm_services.settings.sources import without_settings
from status_json import NO_POSES

EXAMPLES = Path(__file__).parents[2] / "examples"
UNKNOWN = (207, 224, 238)
"""The colour of unknown cells in a plot."""
SCANS = 100
LAST = SCANS - 1
TIMEOUT = 300

WINDOW = '''
"""A window that nobody sees: what it shows is in window.png, and it is closed after `TURNS` turns."""
import json
import os
import pathlib
import time

from matplotlib import pyplot as plt
from matplotlib.backend_bases import FigureManagerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg


class FigureManager(FigureManagerBase):
    def show(self):
        pass


class FigureCanvas(FigureCanvasAgg):
    manager_class = FigureManager
    turns = 0

    def start_event_loop(self, timeout=0):
        if self.figure.axes:
            self.figure.savefig("window.png")
            axes = self.figure.axes[0]
            pathlib.Path("limits.json").write_text(json.dumps([*axes.get_xlim(), *axes.get_ylim()]))
            self.turns += 1
        time.sleep(timeout)
        if self.turns == int(os.environ["TURNS"]):
            plt.close(self.figure)
'''


def start(folder, name, *args, **environ):
    """Start an example in a folder of its own."""
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    return subprocess.Popen(
        [sys.executable, "-W", "error", EXAMPLES / name, *map(str, args)],
        cwd=folder,
        env={**without_settings(os.environ), "MPLBACKEND": "agg", "PYTHONPATH": path, **environ},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def ended(process):
    """How an example ended; one that does not end is killed."""
    with process:
        try:
            out, err = process.communicate(timeout=TIMEOUT)
        finally:
            process.kill()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def run(folder, name, *args, **environ):
    """Run an example to its end."""
    return ended(start(folder, name, *args, **environ))


def call(folder, name, *args):
    """The same in this process, where another one would show no more."""
    words, out, err = [str(EXAMPLES / name), *map(str, args)], io.StringIO(), io.StringIO()
    code = 0
    with chdir(folder), patch.object(sys, "argv", words), redirect_stdout(out), redirect_stderr(err):
        try:
            runpy.run_path(words[0], run_name="__main__")
        except SystemExit as end:
            code = end.code
    if isinstance(code, str):  # as Python itself does
        code, err = 1, io.StringIO(f"{err.getvalue()}{code}\n")
    return subprocess.CompletedProcess(words, code, out.getvalue(), err.getvalue())


def done(end):
    """What an example that ended well has printed."""
    assert end.returncode == 0, end.stderr
    assert "Traceback" not in end.stderr, end.stderr
    return end.stdout


def complaint(end):
    """The one line of an example that failed."""
    assert (end.returncode, end.stdout) == (1, ""), end
    assert re.fullmatch(r"\w+: [^\n]+\n", end.stderr), end.stderr
    return end.stderr


@pytest.fixture(scope="module")
def robot():
    """The names of publish_a_robot.py: the room that it drives through."""
    return runpy.run_path(str(EXAMPLES / "publish_a_robot.py"))


@pytest.fixture(scope="module")
def mapper(module_ogm, tmp_path_factory):
    """A mapper that has mapped the room of publish_a_robot.py."""
    mapper = module_ogm.ready(module_ogm.mapper())
    flags = "--address", mapper.endpoint, "--scans", SCANS, "--rate", 50, "--robot", "anna"
    assert done(run(tmp_path_factory.mktemp("robot"), "publish_a_robot.py", *flags)) == ""
    deadline = time.monotonic() + TIMEOUT
    while mapper.status()["revision"] < SCANS:
        assert time.monotonic() < deadline, mapper.status()
        time.sleep(0.01)
    return mapper


@pytest.fixture
def grid(mapper):
    with MapClient(mapper.url.rstrip("/")) as client:
        return client.get_map()


def test_the_table_lists_every_example():
    listed = re.findall(r"^\| \[`([^`]+)`\]\(([^)]+)\) \|", (EXAMPLES / "README.md").read_text(), re.M)
    assert all(name == link for name, link in listed)
    there = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb")}
    assert {name for name, _ in listed} == there


def test_the_world_is_the_one_that_the_page_on_logs_explains():
    """Where its commands are followed."""
    world = (EXAMPLES / "world.yaml").read_text()
    assert f"```yaml\n{world}```\n" in (EXAMPLES.parent / "docs" / "logs.md").read_text()
    assert "[`world.yaml`](world.yaml)" in (EXAMPLES / "README.md").read_text()


def test_robots_touch_nothing_in_the_world():
    world = load_world((EXAMPLES / "world.yaml").read_text())
    sensor = Lidar(beams=360, range_max=20.0)
    poses = (world.path.pose(i) for i in range(world.path.count))
    assert min(true_ranges(world, pose, sensor).min() for pose in poses) > 0.4


def test_all_but_the_one_that_makes_a_map_do_with_the_client():
    texts = {path.name: path.read_text() for path in EXAMPLES.iterdir() if path.suffix in (".py", ".ipynb")}
    assert [name for name, text in texts.items() if "ogm_core" in text] == ["map_without_network.py"]
    assert not [name for name, text in texts.items() if "ogm_services" in text]


def test_arrays_become_a_map_without_network(tmp_path):
    example = runpy.run_path(str(EXAMPLES / "map_without_network.py"))
    room = example["map_of"](example["readings"]())
    printed = done(run(tmp_path, "map_without_network.py", "--out", "room.png"))
    assert printed == f"room.png: {room.width} x {room.height} cells, of 11 scans\n"
    with Image.open(tmp_path / "room.png") as image:
        shades = {0: 100, 254: 0, 205: -1}
        assert [[shades[grey] for grey in row] for row in np.asarray(image)[::-1]] == room.occupancy.tolist()
    for x, y in [(3.02, 0.5), (-3.02, -1.5), (0.5, 2.02), (-2.5, 2.02), (1.5, -2.02)]:
        assert room.at(x, y) > 0.65, (x, y)
    for x, y in [(0.0, 0.0), (2.9, 1.9), (-2.9, -1.9), (1.5, 2.02), (1.5, 2.5)]:
        assert room.at(x, y) < 0.196, (x, y)
    for x, y in [(0.5, 2.2), (-2.0, 2.2)]:
        assert math.isnan(room.at(x, y)), (x, y)
    of_arrays = example["map_of"]((pose, np.array(ranges)) for pose, ranges in example["readings"]())
    np.testing.assert_array_equal(room.log_odds, of_arrays.log_odds)
    core = EXAMPLES.joinpath("map_without_network.py").read_text().split("def map_of")[1].split("\n\n\n")[0]
    assert len(core.splitlines()) <= 10


def test_every_scan_of_the_robot_is_in_the_map(mapper, grid, robot):
    status = mapper.status()
    assert status["scans"]["integrated"] == status["scans"]["received"] == SCANS
    assert status["poses"] == NO_POSES | {"received": SCANS}
    assert status["robots"].keys() == {"anna"}
    assert status["robots"]["anna"]["pose"] == pytest.approx(robot["drive"](LAST), abs=1e-12)
    for x, y in [(3.02, 1.0), (-3.02, -1.0), (2.0, 2.02), (-2.0, 2.02), (1.0, -2.02), (0.32, 0.1)]:
        assert grid.at(x, y) > 0.65, (x, y)
    for x, y in [(2.9, 1.0), (-2.9, -1.9), (1.8, 0.0), (0.0, 1.1), (0.0, 2.02), (0.0, 3.0), (0.4, 0.1)]:
        assert grid.at(x, y) < 0.196, (x, y)
    for x, y in [(0.0, 0.0), (2.0, 2.2), (-2.0, 2.2)]:
        assert math.isnan(grid.at(x, y)), (x, y)


def drawn(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def unknown(pixels):
    """Which pixels have the colour of unknown cells."""
    return np.abs(pixels - UNKNOWN).max(axis=-1) < 3


def assert_shows_the_room(path, grid):
    """Walls are black, the floor white, the unknown blue, each where it is in metres."""
    pixels = drawn(path)
    blue = unknown(pixels)
    edges = grid.known[0], grid.known[-1], grid.known[:, 0], grid.known[:, -1]
    assert all(not known.all() for known in edges)  # so blue reaches to the edges of the drawn map
    (top, *_, bottom), (left, *_, right) = (np.flatnonzero(blue.any(axis=axis)) for axis in (1, 0))
    scale = (right - left + 1) / (grid.width * grid.resolution)
    assert (bottom - top + 1) / (grid.height * grid.resolution) == pytest.approx(scale, rel=0.02)

    def around(x, y):
        column = left + round((x - grid.origin[0]) * scale)
        row = bottom - round((y - grid.origin[1]) * scale)
        return pixels[row - 2 : row + 3, column - 2 : column + 3].reshape(-1, 3)

    for x, y in [(3.02, 1.0), (-3.02, -1.0), (2.0, 2.02), (-2.0, 2.02), (0.32, 0.1)]:
        assert around(x, y).max(axis=1).min() < 90, (x, y)
    for x, y in [(2.0, 0.0), (-2.0, 1.0), (0.0, 2.02), (0.0, -1.5)]:
        assert around(x, y).min() > 240, (x, y)
    for x, y in [(0.0, 0.0), (2.5, 2.3)]:
        assert unknown(around(x, y)).all(), (x, y)


def test_a_plot_is_the_map(mapper, grid, tmp_path):
    flags = "--out", "live.png", "--revisions", 1
    assert done(run(tmp_path, "subscribe_and_plot.py", "--url", mapper.url.rstrip("/"), *flags)) == ""
    assert_shows_the_room(tmp_path / "live.png", grid)


@pytest.mark.parametrize(("flags", "turns"), [((), 3), (("--revisions", 1), 1000)])
def test_a_window_shows_the_map_until_it_is_closed(mapper, grid, tmp_path, flags, turns):
    (tmp_path / "window.py").write_text(WINDOW)
    environ = {"MPLBACKEND": "module://window", "TURNS": str(turns)}
    assert done(run(tmp_path, "subscribe_and_plot.py", "--url", mapper.endpoint, *flags, **environ)) == ""
    assert_shows_the_room(tmp_path / "window.png", grid)
    (left, bottom), width, height = grid.origin, grid.width * 0.05, grid.height * 0.05
    limits = json.loads((tmp_path / "limits.json").read_text())
    assert limits == pytest.approx([left, left + width, bottom, bottom + height])


def test_a_plot_follows_the_robot_until_it_has_seen_enough_or_ctrl_c(module_ogm, tmp_path, eventually):
    mapper = module_ogm.ready(module_ogm.mapper())
    plot = "subscribe_and_plot.py", "--url", mapper.endpoint, "--out"
    endless = [
        start(tmp_path, "publish_a_robot.py", "--address", mapper.endpoint, "--rate", 50),
        start(tmp_path, *plot, "endless.png"),
    ]
    try:
        assert done(run(tmp_path, *plot, "live.png", "--revisions", 3)) == ""
        assert mapper.status()["revision"] >= 2
        assert unknown(drawn(tmp_path / "live.png")).sum() > 1000
        eventually((tmp_path / "endless.png").exists, TIMEOUT)
    finally:
        for process in endless:
            process.send_signal(signal.SIGINT)
        ends = [ended(process) for process in endless]
    assert [done(end) for end in ends] == ["", ""]


def test_without_a_display_it_asks_for_a_file(tmp_path):
    assert "--out FILE" in complaint(run(tmp_path, "subscribe_and_plot.py"))


def read_by_nav2(description):
    """Occupancy [iy, ix], resolution and origin, by the rules of nav2's map_server for mode trinary."""
    fields = yaml.safe_load(description.read_text())
    assert (fields["mode"], fields["negate"]) == ("trinary", 0)
    with Image.open(description.parent / fields["image"]) as image:
        assert (image.format, image.mode) == ("PPM", "L")
        shade = (255 - np.asarray(image)[::-1]) / 255.0
    occupied, free = shade > fields["occupied_thresh"], shade < fields["free_thresh"]
    return np.where(occupied, 100, np.where(free, 0, -1)), fields["resolution"], fields["origin"]


@pytest.mark.parametrize("region", [None, (-3.2, -2.2, -0.11, 1)])
def test_nav2_reads_the_exported_map(mapper, grid, tmp_path, region):
    flags = () if region is None else ("--region", *region)
    printed = done(run(tmp_path, "export_to_nav2.py", "--url", mapper.endpoint, "--out", "room.yaml", *flags))
    expected = grid if region is None else grid.crop(region)
    occupancy, resolution, origin = read_by_nav2(tmp_path / "room.yaml")
    np.testing.assert_array_equal(occupancy, expected.occupancy)
    assert (occupancy == 100).sum() > 50
    assert (resolution, tuple(origin)) == (0.05, (*expected.origin, 0.0))
    assert printed == f"room.yaml: {expected.width} x {expected.height} cells, revision {SCANS}\n"


def displayed(notebook, mapper):
    """What each cell of code shows, by the cell's id: the value of its last expression."""
    names, shown = {"__name__": "__main__"}, {}
    try:
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code":
                source = "".join(cell["source"])
                if cell["id"] == "connect":
                    assert "\nADDRESS = DEFAULT_ADDRESS" in source
                    source = source.replace("\nADDRESS = DEFAULT_ADDRESS", f"\nADDRESS = {mapper.endpoint!r}")
                body = ast.parse(source)
                last = body.body.pop() if isinstance(body.body[-1], ast.Expr) else None
                exec(compile(body, cell["id"], "exec"), names)
                if last is not None:
                    shown[cell["id"]] = eval(compile(ast.Expression(last.value), cell["id"], "eval"), names)
    finally:
        names["mapper"].close()
    return shown, names


def test_the_notebook_shows_the_map(mapper, grid, robot):
    notebook = json.loads((EXAMPLES / "map_in_a_notebook.ipynb").read_text())
    cells = notebook["cells"]
    assert (notebook["nbformat"], notebook["nbformat_minor"]) == (4, 5)
    assert len({cell["id"] for cell in cells}) == len(cells)
    assert all(
        (cell["outputs"], cell["execution_count"]) == ([], None) for cell in cells if "outputs" in cell
    )

    shown, names = displayed(notebook, mapper)
    whole, part = shown["whole"]._repr_html_(), shown["robot"]._repr_html_()
    x, y, theta = robot["drive"](LAST)
    around = grid.crop((x - 1.5, y - 1.5, x + 1.5, y + 1.5))
    assert (whole, part) == (grid._repr_html_(), around._repr_html_())
    assert f"{grid.width} × {grid.height} cells of 0.05 m" in whole
    assert f"revision {SCANS}" in whole
    assert "data:image/png;base64," in whole
    assert part != whole
    assert shown["beam"] == grid.raycast(x, y, theta)
    assert isinstance(shown["beam"], Ray)
    robot["measure"].__globals__["MOUNT"] = (0.0, 0.0, 0.0)
    measured, predicted = robot["measure"](x, y, theta), names["scan"]
    walls = predicted.found == "occupied"
    assert 200 < walls.sum() < 360
    assert np.mean(np.abs(predicted.range[walls] - measured[walls]) < 0.08) > 0.95
    nearest = re.fullmatch(r"(\d+) of 360 beams meet something, the nearest at (\d\.\d\d) m", shown["scan"])
    assert int(nearest[1]) == walls.sum()
    assert float(nearest[2]) == pytest.approx(measured.min(), abs=0.06)
    free, occupied = map(float, re.fullmatch(r"free (.+) m2, occupied (.+) m2", shown["arrays"]).groups())
    assert free == pytest.approx((grid.occupancy == 0).sum() * 0.0025, abs=0.06)
    assert occupied == pytest.approx((grid.occupancy == 100).sum() * 0.0025, abs=0.06)


def test_when_nobody_answers_every_example_says_what_to_check(endpoint, mapper, tmp_path):
    commands = {
        ("publish_a_robot.py", "--address", "tcp/127.0.0.1"): "a host and a port",  # a mapper it waits for
        ("subscribe_and_plot.py", "--out", "x.png", "--url", endpoint): endpoint,
        ("map_without_network.py", "--out", "no/such/folder.png"): "No such file",
        ("export_to_nav2.py", "--url", endpoint): endpoint,
        ("export_to_nav2.py", "--url", mapper.endpoint, "--map", "hall"): "no mapper of map 'hall'",
        ("export_to_nav2.py", "--url", mapper.endpoint, "--out", "no/such/folder"): "No such file",
        ("export_to_nav2.py", "--url", mapper.endpoint, "--region", 50, 50, 51, 51): "outside the map",
    }
    of_their_own = [("publish_a_robot.py", "--address"), ("subscribe_and_plot.py", "--out")]
    for command, text in commands.items():
        start = run if command[:2] in of_their_own else call
        assert text in complaint(start(tmp_path, *command))
    assert list(tmp_path.iterdir()) == []
