"""`ogm demo`: the main job in one command. The map shows what stands in the lab, and nothing else."""

import json
import signal
import socket
import threading
import time
from contextlib import suppress
from http.client import HTTPException

import numpy as np
import pytest
import yaml
from PIL import Image

FREE_PORTS = ("--http-port", "0", "--listen", "tcp/127.0.0.1:0")
CIRCLES = [(-3.0, 2.0, 1.2), (2.5, -1.0, 1.0), (4.0, 4.0, 1.5), (-4.5, -4.0, 1.0)]
DRIVEN_THROUGH = CIRCLES[2:]
WALL = 10.0
OCCUPIED, UNKNOWN, FREE = 0, 205, 254
FILES = {"map.png", "map.pgm", "map.yaml", "map.npz", "quality.json"}


class Picture:
    """A map as nav2 reads it: pixels at world coordinates, m."""

    def __init__(self, folder):
        fields = yaml.safe_load((folder / "map.yaml").read_text())
        self.resolution = fields["resolution"]
        self.x0, self.y0, _ = fields["origin"]
        with Image.open(folder / fields["image"]) as image:
            self.grey = np.asarray(image)[::-1]  # row 0 south

    def at(self, x, y):
        """Greys at points."""
        return self.grey[self._cell(y, self.y0), self._cell(x, self.x0)]

    def wall_near(self, x, y):
        """Whether a cell at each point, or one of its eight neighbours, is occupied."""
        iy, ix = self._cell(y, self.y0), self._cell(x, self.x0)
        return np.any(
            [self.grey[iy + dy, ix + dx] == OCCUPIED for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=0
        )

    def walls(self):
        """Centres x, y of all occupied cells."""
        iy, ix = np.nonzero(self.grey == OCCUPIED)
        return self.x0 + (ix + 0.5) * self.resolution, self.y0 + (iy + 0.5) * self.resolution

    def _cell(self, metres, origin):
        return np.floor((np.asarray(metres) - origin) / self.resolution).astype(int)


def from_outlines(x, y):
    """Distance of points to the nearest outline in the lab, m."""
    circles = [np.abs(np.hypot(x - cx, y - cy) - r) for cx, cy, r in CIRCLES]
    return np.min([*circles, np.abs(np.abs(x) - WALL), np.abs(np.abs(y) - WALL)], axis=0)


@pytest.fixture(scope="module", autouse=True)
def lap_under_way(module_ogm):
    """A demo of a lap (11 s) and some more, beside the first tests; and what its status says meanwhile."""
    mapper = module_ogm.ready(module_ogm.start("demo", "--duration", 14, "--out", "out", *FREE_PORTS))
    seen = [mapper.status()]

    def watch():
        while mapper.command.process.poll() is None:
            with suppress(OSError, HTTPException):  # the mapper ends before the demo does
                seen.append(mapper.status())
            time.sleep(0.1)

    watcher = threading.Thread(target=watch)
    watcher.start()
    yield mapper.command, seen
    with suppress(ProcessLookupError):
        mapper.command.process.terminate()
    watcher.join()


@pytest.fixture(scope="module")
def lap(lap_under_way, module_ogm):
    """How the lap ended, the folder that it left, and what the mapper's status said on the way."""
    demo, seen = lap_under_way
    return demo.wait(), module_ogm.folder / "out", seen


@pytest.mark.parametrize(
    ("number", "group"),
    [
        pytest.param(signal.SIGINT, True, id="Ctrl-C in the terminal"),
        pytest.param(signal.SIGTERM, False, id="SIGTERM to the demo alone"),
    ],
)
def test_the_demo_ends_when_told(ogm, eventually, number, group):
    demo = ogm.start("demo", "--out", "out", *FREE_PORTS)
    mapper = ogm.ready(demo)
    eventually(lambda: mapper.status()["revision"] > 3)
    ended = demo.stop(number, group=group)
    assert (ended.code, ended.warnings) == (0, "")
    assert {path.name for path in (ogm.folder / "out").iterdir()} == FILES


def test_the_demo_ends_by_itself_and_its_books_balance(lap):
    ended, out, seen = lap
    assert (ended.code, ended.warnings) == (0, "")
    assert {path.name for path in out.iterdir()} == FILES
    assert len(seen) > 20
    assert sum(seen[-1]["scans"]["dropped"].values()) == 0
    quality = json.loads((out / "quality.json").read_text())
    assert seen[-1]["scans"]["integrated"] <= quality["scans"]
    assert 220 <= quality["scans"] <= 320  # 20 a second, from the first one on, on a busy machine fewer
    assert quality["consistency"]["free"] > 0.95


def test_what_it_leaves_says_how_true_the_map_is_and_how_it_settled(lap):
    text = (lap[1] / "quality.json").read_text()
    quality = json.loads(text)
    assert quality["truth"]["accuracy"] > 0.98
    assert quality["truth"]["precision"] > 0.99
    assert quality["truth"]["recall"] > 0.95
    series = quality["series"]
    assert 4 < len(series["stamp"]) == len(series["known_m2"]) == len(series["mean_entropy_bits"]) < 30
    assert series["revision"] == sorted(set(series["revision"]))
    assert series["known_m2"][0] < 0.5 * series["known_m2"][-1] <= 0.5 * quality["known_m2"]
    assert series["mean_entropy_bits"][-1] < 0.2 * series["mean_entropy_bits"][0]
    assert len(text.splitlines()) < 40  # each list on one line


def test_the_circles_stand_where_the_lab_has_them(lap):
    picture = Picture(lap[1])
    angle = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    for cx, cy, r in CIRCLES:
        outline = picture.wall_near(cx + r * np.cos(angle), cy + r * np.sin(angle))
        assert outline.mean() > 0.95, (cx, cy, r)
        # A robot that drives through a circle sees it from inside; the others stay closed.
        inside = picture.at(cx + 0.8 * r * np.cos(angle), cy + 0.8 * r * np.sin(angle))
        assert np.mean(inside == (FREE if (cx, cy, r) in DRIVEN_THROUGH else UNKNOWN)) > 0.99


def test_the_walls_stand_where_the_lab_has_them(lap):
    picture = Picture(lap[1])
    along = np.linspace(-8.0, 8.0, 800)  # the corners are out of the LiDAR's reach
    for wall in (-WALL, WALL):
        across = np.full_like(along, wall)
        assert picture.wall_near(across, along).mean() > 0.99
        assert picture.wall_near(along, across).mean() > 0.99


def test_nothing_else_stands_in_the_lab(lap):
    picture = Picture(lap[1])
    wrong = from_outlines(*picture.walls())
    assert np.mean(wrong < 0.1) > 0.99
    assert wrong.max() < 0.25
    x, y = np.random.default_rng(1).uniform(-8.5, 8.5, (2, 20_000))
    closed = np.any([np.hypot(x - cx, y - cy) < r for cx, cy, r in CIRCLES[:2]], axis=0)
    room = (from_outlines(x, y) > 0.2) & ~closed
    assert np.mean(picture.at(x[room], y[room]) == FREE) > 0.99


def test_the_demo_ends_when_told_before_it_is_ready(ogm, eventually):
    demo = ogm.start("demo", *FREE_PORTS)
    eventually(lambda: len(demo.processes()) > 1)  # the mapper is starting
    assert demo.stop(signal.SIGTERM).code == 0


@pytest.mark.parametrize("victim", ["mapper", "simulate"])
def test_the_demo_says_which_of_its_processes_died(ogm, eventually, victim):
    demo = ogm.start("demo", *FREE_PORTS)
    mapper = ogm.ready(demo)
    eventually(lambda: mapper.status()["revision"] > 0)
    demo.kill_child(victim)
    ended = demo.wait()
    assert ended.code == 1
    name = {"mapper": "the mapper", "simulate": "the simulator"}[victim]
    assert f"ogm: {name} ended with exit code -9\n" in ended.err
    assert "Traceback" not in ended.err


@pytest.mark.parametrize("flag", ["--http-port", "--listen"])
def test_a_taken_port_is_named(ogm, flag):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ports = {"--http-port": "0", "--listen": "tcp/127.0.0.1:0"}
        ports[flag] = ports[flag].removesuffix("0") + str(port)
        ended = ogm.run("demo", *(text for item in ports.items() for text in item))
    assert (ended.code, ended.out) == (1, "")
    first, second = ended.warnings.splitlines()
    assert flag in first
    assert str(port) in first
    assert second == "ogm: the mapper ended with exit code 1"
