import math
import subprocess
import sys

import numpy as np
import pytest

from ogm_core.errors import BadWorld
from ogm_core.files.strict_yaml import parse_yaml
from ogm_core.lattice import Region
from ogm_core.simulation.catalogue import office, world_named
from ogm_core.simulation.trajectories import CirclePath, WaypointPath
from ogm_core.simulation.worlds import dump_world, lab, load_world
from ogm_core.types import Pose

TOO_DEEP = "lists and mappings lie in each other more than 50 deep", "exceeded maximum nesting depth"
"""Our words, and those of a libyaml that has a limit, too."""
PATH = "path: {circle: [0, 0, 2], poses: 10}\n"
HALL = """
name: hall
circles: [[1, 2, 0.5]]
boxes: [[0, 0, 4, 3]]
walls: [[0, 5, 6, 7.5]]
path: {waypoints: [[1, 1], [2, 1], [2, 2]], spacing: 0.25}
"""


def same(a, b):
    return (
        a.name == b.name
        and np.array_equal(a.circles, b.circles)
        and np.array_equal(a.segments, b.segments)
        and a.path == b.path
    )


def clearances(world, points):
    """Distance of every point to every obstacle's outline, m; naive."""
    for x, y in points:
        for cx, cy, r in world.circles.tolist():
            yield math.hypot(x - cx, y - cy) - r
        for x1, y1, x2, y2 in world.segments.tolist():
            ex, ey = x2 - x1, y2 - y1
            t = min(1.0, max(0.0, ((x - x1) * ex + (y - y1) * ey) / (ex * ex + ey * ey)))
            yield math.hypot(x1 + t * ex - x, y1 + t * ey - y)


def test_lab_is_the_textbook_exercise():
    world = lab()
    assert world.name == "lab"
    assert world.circles.tolist() == [[-3, 2, 1.2], [2.5, -1, 1], [4, 4, 1.5], [-4.5, -4, 1]]
    assert {frozenset([(x1, y1), (x2, y2)]) for x1, y1, x2, y2 in world.segments.tolist()} == {
        frozenset([(-10, -10), (10, -10)]),
        frozenset([(10, -10), (10, 10)]),
        frozenset([(10, 10), (-10, 10)]),
        frozenset([(-10, 10), (-10, -10)]),
    }
    assert len(world.segments) == 4
    assert world.bounds == Region(-10, -10, 10, 10)
    assert world.path == CirclePath(0.0, 0.0, 6.0, 220)
    assert world.path.pose(0) == Pose(6.0, 0.0, math.pi / 2)


def test_lab_robot_drives_through_two_obstacles():
    world = lab()
    poses = [world.path.pose(i) for i in range(world.path.count)]
    entered = [any(math.dist(pose[:2], (cx, cy)) < r for pose in poses) for cx, cy, r in world.circles]
    assert entered == [False, False, True, True]


def test_office_robot_touches_nothing():
    world = office()
    points = [world.path.pose(i)[:2] for i in range(0, world.path.count, 2)]
    assert min(clearances(world, points)) >= 0.25
    assert world.bounds == Region(0, 0, 30, 20)


def test_office_robot_visits_every_room():
    path = office().path
    points = np.array([path.pose(i)[:2] for i in range(path.count)])
    rooms = [(a, 0, b, 6) for a, b in [(0, 5), (5, 10), (10, 17), (17, 22), (22, 30)]]
    rooms += [(a, 14, b, 20) for a, b in [(0, 6), (6, 10.5), (10.5, 19.5), (19.5, 24), (24, 30)]]
    rooms += [(a, 8, b, 12) for a, b in [(2.5, 8), (8, 13), (17, 22), (22, 27.5)]]
    for xmin, ymin, xmax, ymax in rooms:
        inside = (points > (xmin + 0.5, ymin + 0.5)).all(axis=1) & (points < (xmax - 0.3, ymax - 0.3)).all(
            axis=1
        )
        assert inside.sum() > 20, (xmin, ymin, xmax, ymax)


def test_reads_a_world():
    world = load_world(HALL)
    assert world.name == "hall"
    assert world.circles.tolist() == [[1, 2, 0.5]]
    assert world.segments.tolist() == [
        [0, 5, 6, 7.5],
        [0, 0, 4, 0],
        [4, 0, 4, 3],
        [4, 3, 0, 3],
        [0, 3, 0, 0],
    ]
    assert world.path == WaypointPath(((1, 1), (2, 1), (2, 2)), 0.25)
    assert world.bounds == Region(0, 0, 6, 7.5)


def test_bounds_hold_circles():
    assert load_world("circles: [[1, 2, 0.5], [4, 0, 1]]\n" + PATH).bounds == Region(0.5, -1, 5, 2.5)


def test_one_obstacle_and_a_path_are_enough():
    world = load_world("circles: [[1, 2, 0.5]]\n" + PATH)
    assert (world.name, world.circles.shape, world.segments.shape) == ("world", (1, 3), (0, 4))


def test_arrays_cannot_be_written():
    with pytest.raises(ValueError, match="read-only"):
        lab().circles[0, 0] = 1.0


@pytest.mark.parametrize("make", [lab, office, lambda: load_world(HALL)])
def test_dump_reads_back(make):
    assert same(load_world(dump_world(make())), make())


def test_dump_keeps_every_bit():
    world = load_world(
        {
            "name": "1e3: ünusual",
            "circles": [[0.1 + 0.2, 1e-5, 1 / 3]],
            "path": {"circle": [-1e-9, 0, 1e5], "poses": 3},
        }
    )
    assert same(load_world(dump_world(world)), world)


def test_aliases_are_read():
    world = load_world("circles: [&c [0, 0, 1]]\npath: {circle: *c, poses: 3}\n")
    assert world.path == CirclePath(0, 0, 1, 3)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a mapping with the keys name, circles, boxes, walls, path is needed, got nothing"),
        ("just words", "a mapping .* got 'just words'"),
        ("[1, 2]", "a mapping .* got a list of 2"),
        ("circles: [[1, 2", "not YAML"),
        ("a: 1\n---\nb: 2", "not YAML"),
        ("circles: !!python/object/apply:os.getcwd []\n" + PATH, "not YAML"),
        ("circles: !!bool maybe\n" + PATH, "not YAML"),
        ("circles: 2024-13-45\n" + PATH, "not YAML"),
        ("? {a: b}\n: c", "not YAML"),
        ("circles: \x00", "not YAML"),
        ("circles: [[0, 0, 1]]\ncircles: [[1, 1, 1]]\n" + PATH, "not YAML .*key 'circles' is given twice"),
        (PATH, "the world is empty: add circles, boxes or walls"),
        ("circles: []\nwalls:\n" + PATH, "the world is empty"),
        ("circles: [[0, 0, 1]]", "path: missing; add .* path: {circle"),
        ("circles: [[0, 0, 1]]\npath:", "path: missing; add"),
        (
            "polygons: [[0, 0]]\n" + PATH,
            "unknown key 'polygons'; known are name, circles, boxes, walls, path",
        ),
        ("3: 4\n" + PATH, "unknown key 3;"),
        ("name: 7\ncircles: [[0, 0, 1]]\n" + PATH, "name: text is needed, got 7"),
        ("name: ''\ncircles: [[0, 0, 1]]\n" + PATH, "name: text is needed"),
        ("image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]", "this is a ROS map file: give its path"),
        # Circles, boxes, walls.
        ("circles: 3\n" + PATH, r"circles: a list of \[cx, cy, r\] is needed, got 3"),
        ("circles: {a: 1}\n" + PATH, "circles: a list .* got a mapping"),
        (
            "circles: [[0, 0, 1], [0, 1]]\n" + PATH,
            r"circles: entry 1: \[cx, cy, r\] is needed, got a list of 2",
        ),
        ("circles: [5]\n" + PATH, r"circles: entry 0: \[cx, cy, r\] is needed, got 5"),
        ("circles: [[0, 0, 0]]\n" + PATH, "circles: entry 0: a radius above 0 is needed, got 0"),
        ("circles: [[0, 0, 1], [0, 0, -2]]\n" + PATH, "circles: entry 1: a radius above 0 is needed, got -2"),
        ("circles: [[0, .nan, 1]]\n" + PATH, "circles: entry 0: a finite number .* got nan"),
        ("circles: [[0, -.inf, 1]]\n" + PATH, "circles: entry 0: a finite number .* got -inf"),
        ("circles: [[0, 0, true]]\n" + PATH, "circles: entry 0: a number is needed, got True"),
        ("circles: [[0, 0, '1e3']]\n" + PATH, "circles: entry 0: a number is needed, got '1e3'"),
        ("circles: [[0, 0, 1_0]]\n" + PATH, "circles: entry 0: a number is needed, got '1_0'"),
        ("circles: [[0, 0, null]]\n" + PATH, "circles: entry 0: a number is needed, got nothing"),
        ("boxes: [[0, 0, 0, 1]]\n" + PATH, "boxes: entry 0: .* xmin < xmax and ymin < ymax"),
        ("boxes: [[0, 2, 1, 1]]\n" + PATH, "boxes: entry 0: .* xmin < xmax and ymin < ymax"),
        ("walls: [[0, 2, 1]]\n" + PATH, r"walls: entry 0: \[x1, y1, x2, y2\] is needed"),
        ("walls: [[0, 0, 1, 0], [3, 2, 3, 2]]\n" + PATH, "walls: entry 1: its two ends are the same point"),
        # The path.
        ("circles: [[0, 0, 1]]\npath: around", "path: a mapping with either circle or waypoints is needed"),
        ("circles: [[0, 0, 1]]\npath: {spline: 3}", "path: a mapping with either circle or waypoints"),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0, 1], waypoints: []}", "path: a mapping with either"),
        (
            "circles: [[0, 0, 1]]\npath: {circle: [0, 0, 1], spacing: 1}",
            "path: unknown key 'spacing'; known are circle",
        ),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0, 1]}", "path: poses: how many, .* got nothing"),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0, 1], poses: 2.5}", "path: poses: .* got 2.5"),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0, 1], poses: true}", "path: poses: .* got True"),
        (
            f"circles: [[0, 0, 1]]\npath: {{circle: [0, 0, 1], poses: {10**400}}}",
            "path: poses: 1 to 100000 are needed, got one beyond 1e",
        ),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0, 1], poses: 0}", "path: poses: 1 to"),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0], poses: 3}", r"path: circle: \[cx, cy, r\] is needed"),
        ("circles: [[0, 0, 1]]\npath: {circle: [0, 0, 0], poses: 3}", "path: circle: a radius above 0"),
        (
            "circles: [[0, 0, 1]]\npath: {waypoints: [[0, 0], [1]], spacing: 1}",
            r"path: waypoints: entry 1: \[x, y\]",
        ),
        (
            "circles: [[0, 0, 1]]\npath: {waypoints: [[0, 0], [1, .inf]], spacing: 1}",
            "path: waypoints: entry 1: a fin",
        ),
        ("circles: [[0, 0, 1]]\npath: {waypoints: [], spacing: 1}", "path: waypoints: at least 2"),
        ("circles: [[0, 0, 1]]\npath: {waypoints: [[0, 0], [1, 0]]}", "path: spacing: missing; add"),
        ("circles: [[0, 0, 1]]\npath: {waypoints: [[0, 0], [1, 0]], spacing: no}", "path: spacing: a number"),
        ("circles: [[0, 0, 1]]\npath: {waypoints: [[0, 0], [1, 0]], poses: 5}", "path: unknown key 'poses'"),
    ],
)
def test_refusals(text, message):
    with pytest.raises(BadWorld, match=f"(?s)^{message}") as caught:
        load_world(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_an_alias_bomb_is_refused_without_being_spelt_out():
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 12)]
    with pytest.raises(BadWorld, match="unknown key 'a0'"):
        load_world("\n".join(lines))
    inline = "circles: &a [[0, 0, 1], &b [0, 0, *a]]\n"
    with pytest.raises(BadWorld, match="circles: entry 1: a number is needed, got a list of 2"):
        load_world(inline + PATH)


@pytest.mark.parametrize(
    "text",
    [
        "[" * 51,
        "[" * (2 * sys.getrecursionlimit()),
        "a: " + "[" * 200_000,
        "a: " + "[" * 50_000 + "]" * 50_000,
        "{a: " * 50_000,
        "\n".join(" " * k + "- " for k in range(3000)),
        "\n".join(" " * k + "a:" for k in range(3000)),
    ],
    ids=["51 lists", "recursion", "open lists", "closed lists", "mappings", "block lists", "block mappings"],
)
def test_deep_nesting_is_refused(text):
    # In a process of its own: what recurses without end in C ends the process.
    script = "import sys; from ogm_core.simulation.worlds import load_world; load_world(sys.stdin.read())"
    ended = subprocess.run(
        [sys.executable, "-c", script], input=text, text=True, capture_output=True, timeout=300
    )
    assert ended.returncode == 1
    last = ended.stderr.splitlines()[-1]
    assert last.startswith("ogm_core.errors.BadWorld: not YAML that can be read (")
    assert any(words in last for words in TOO_DEEP)


def test_fifty_levels_are_not_too_deep():
    assert parse_yaml("[" * 50 + "]" * 50) is not None
    with pytest.raises(ValueError, match="more than 50 deep"):
        parse_yaml("[" * 51 + "]" * 51)


@pytest.mark.parametrize("digits", ["1" + "0" * 400, "1" + "0" * 9000, "0x" + "f" * 9000])
def test_endless_integers_are_refused(digits):
    with pytest.raises(BadWorld, match=r"circles: entry 0: a finite number|not YAML"):
        load_world(f"circles: [[0, 0, {digits}]]\n{PATH}")


@pytest.mark.parametrize("name", ["lab", "office"])
def test_built_in_worlds_have_names(name):
    assert world_named(name).name == name


def test_world_from_a_file(tmp_path):
    file = tmp_path / "hall.yaml"
    file.write_text(HALL, encoding="utf-8")
    assert same(world_named(str(file)), load_world(HALL))


def test_refusals_name_the_file(tmp_path):
    file = tmp_path / "hall.yaml"
    file.write_text("boxes: 3\n" + PATH, encoding="utf-8")
    with pytest.raises(BadWorld, match=r"^world '.*hall\.yaml': boxes: a list"):
        world_named(str(file))
    file.write_bytes(b"name: \xff\xfe")
    with pytest.raises(BadWorld, match=r"hall\.yaml': not a file that can be read"):
        world_named(str(file))


@pytest.mark.parametrize("name", ["", "labb", "no/such.yaml", "nul\0byte", "x" * 5000])
def test_missing_files_name_the_built_in_worlds(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadWorld, match=r"built-in world \(lab, office\)"):
        world_named(name)


def test_worlds_load_neither_pictures_nor_ways():
    code = (
        "import sys; from ogm_core.simulation.catalogue import world_named; world_named('office')\n"
        "print({'PIL', 'scipy', 'ogm_core.simulation.patrol'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
