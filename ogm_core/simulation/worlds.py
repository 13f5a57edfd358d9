"""Simulated worlds: what stands in them, and how a robot drives through them.

A world file is YAML, all lengths in metres:

    name: hall
    circles: [[cx, cy, r], ...]
    boxes: [[xmin, ymin, xmax, ymax], ...]    # their outlines
    walls: [[x1, y1, x2, y2], ...]
    path: {circle: [cx, cy, r], poses: 220}   # or {waypoints: [[x, y], ...], spacing: 0.1}

Only `path` and one obstacle are needed. The YAML file of a ROS map is a world, too (see ros_map_world).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import BadWorld
from ogm_core.files.strict_yaml import dump_yaml, parse_yaml, shown
from ogm_core.lattice import Region
from ogm_core.simulation.trajectories import CirclePath, WaypointPath

MAX_COORDINATE = 1e6
"""The largest coordinate and length, m."""
_KEYS = ("name", "circles", "boxes", "walls", "path")
_ADD_A_PATH = (
    "for example path: {circle: [0, 0, 2], poses: 100} or {waypoints: [[0, 0], [3, 0]], spacing: 0.1}"
)
_BOX = "[xmin, ymin, xmax, ymax]"


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Obstacles and a robot's path, in the world frame, m; the obstacles are outlines.

    `circles` float64, shape (n, 3): [cx, cy, r]; `segments` float64, shape (m, 4): [x1, y1, x2, y2];
    n + m >= 1.
    """

    name: str
    circles: NDArray[np.float64]
    segments: NDArray[np.float64]
    path: CirclePath | WaypointPath

    @property
    def bounds(self) -> Region:
        """The smallest rectangle around every obstacle."""
        centres, radii = self.circles[:, :2], self.circles[:, 2:]
        corners = np.concatenate(
            (centres - radii, centres + radii, self.segments[:, :2], self.segments[:, 2:]), axis=0
        )
        return Region(*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist())


def lab() -> World:
    """The world of preset `lab`: four circles inside walls at +-10 m.

    The robot's circle cuts through two of the obstacles on purpose.
    """
    return World(
        name="lab",
        circles=_frozen([(-3.0, 2.0, 1.2), (2.5, -1.0, 1.0), (4.0, 4.0, 1.5), (-4.5, -4.0, 1.0)], 3),
        segments=_frozen(_outline((-10.0, -10.0, 10.0, 10.0)), 4),
        path=CirclePath(0.0, 0.0, 6.0, 220),
    )


def load_world(description: str | Mapping[str, object]) -> World:
    """Read a world from YAML text, or from the mapping that such text stands for.

    Raises:
        BadWorld: it is not one; the text names the key and the entry.
    """
    fields = fields_of(description) if isinstance(description, str) else description
    if "image" in fields:
        raise BadWorld("this is a ROS map file: give its path, so that its picture is found beside it")
    _refuse_unknown(fields, _KEYS, "")
    name = fields.get("name", "world")
    if not (isinstance(name, str) and name):
        raise BadWorld(f"name: text is needed, got {shown(name)}")
    circles = _rows(fields, "circles", "[cx, cy, r]")
    boxes = _rows(fields, "boxes", _BOX)
    walls = _rows(fields, "walls", "[x1, y1, x2, y2]")
    _check_shapes(circles, boxes, walls)
    if not (circles or boxes or walls):
        raise BadWorld("the world is empty: add circles, boxes or walls")
    segments = [*walls, *(side for box in boxes for side in _outline(box))]
    return World(name, _frozen(circles, 3), _frozen(segments, 4), _path(fields.get("path")))


def dump_world(world: World) -> str:
    """YAML text that `load_world` reads back as the same world (boxes have become walls)."""
    path: dict[str, object]
    match world.path:
        case CirclePath(cx, cy, r, count):
            path = {"circle": [cx, cy, r], "poses": count}
        case WaypointPath(points, spacing):
            path = {"waypoints": [list(point) for point in points], "spacing": spacing}
    fields = {
        "name": world.name,
        "circles": world.circles.tolist(),
        "walls": world.segments.tolist(),
        "path": path,
    }
    return dump_yaml(fields)


def fields_of(text: str) -> Mapping[str, object]:
    """What a world file says, by key; BadWorld if it is no mapping."""
    try:
        fields = parse_yaml(text)
    except ValueError as error:
        raise BadWorld(str(error)) from error
    if not isinstance(fields, dict):
        raise BadWorld(f"a mapping with the keys {', '.join(_KEYS)} is needed, got {shown(fields)}")
    return fields


def _path(path: object) -> CirclePath | WaypointPath:
    if path is None:
        raise BadWorld(f"path: missing; add how the robot drives, {_ADD_A_PATH}")
    if not isinstance(path, Mapping) or ("circle" in path) == ("waypoints" in path):
        raise BadWorld(f"path: a mapping with either circle or waypoints is needed, {_ADD_A_PATH}")
    if "circle" in path:
        _refuse_unknown(path, ("circle", "poses"), "path: ")
        cx, cy, r = _numbers(path["circle"], "[cx, cy, r]", "path: circle")
        count = path.get("poses")
        if isinstance(count, bool) or not isinstance(count, int):
            raise BadWorld(f"path: poses: how many, a whole number, is needed, got {shown(count)}")
        return CirclePath(cx, cy, r, count)
    _refuse_unknown(path, ("waypoints", "spacing"), "path: ")
    points = tuple((x, y) for x, y in _rows(path, "waypoints", "[x, y]", "path: "))
    if "spacing" not in path:
        raise BadWorld(
            "path: spacing: missing; add the distance between two poses, m, for example spacing: 0.1"
        )
    return WaypointPath(points, _number(path["spacing"], "path: spacing"))


def _refuse_unknown(fields: Mapping[str, object], known: tuple[str, ...], where: str) -> None:
    for key in fields:
        if key not in known:
            raise BadWorld(f"{where}unknown key {shown(key)}; known are {', '.join(known)}")


def _rows(fields: Mapping[str, object], key: str, form: str, where: str = "") -> list[tuple[float, ...]]:
    """The list under `key`, [] if there is none; every entry has the numbers that `form` names."""
    rows = fields.get(key)
    if rows is None:
        return []
    if not isinstance(rows, list | tuple):
        raise BadWorld(f"{where}{key}: a list of {form} is needed, got {shown(rows)}")
    return [_numbers(row, form, f"{where}{key}: entry {k}") for k, row in enumerate(rows)]


def _numbers(values: object, form: str, where: str) -> tuple[float, ...]:
    if not isinstance(values, list | tuple) or len(values) != form.count(",") + 1:
        raise BadWorld(f"{where}: {form} is needed, got {shown(values)}")
    return tuple(_number(value, where) for value in values)


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise BadWorld(f"{where}: a number is needed, got {shown(value)}")
    if not abs(value) <= MAX_COORDINATE:
        raise BadWorld(
            f"{where}: a finite number of at most {MAX_COORDINATE:g} m is needed, got {shown(value)}"
        )
    return float(value)


def _check_shapes(
    circles: list[tuple[float, ...]], boxes: list[tuple[float, ...]], walls: list[tuple[float, ...]]
) -> None:
    for k, (_, _, r) in enumerate(circles):
        if not r > 0.0:
            raise BadWorld(f"circles: entry {k}: a radius above 0 is needed, got {r:g}")
    for k, (xmin, ymin, xmax, ymax) in enumerate(boxes):
        if not (xmin < xmax and ymin < ymax):
            raise BadWorld(f"boxes: entry {k}: {_BOX} with xmin < xmax and ymin < ymax is needed")
    for k, (x1, y1, x2, y2) in enumerate(walls):
        if (x1, y1) == (x2, y2):
            raise BadWorld(f"walls: entry {k}: its two ends are the same point")


def _outline(box: tuple[float, ...]) -> list[tuple[float, ...]]:
    """The four sides of a box [xmin, ymin, xmax, ymax], counter-clockwise; corners are shared bit for bit."""
    xmin, ymin, xmax, ymax = box
    corners = [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]
    return [(*corners[k - 1], *corners[k]) for k in (1, 2, 3, 0)]


def _frozen(rows: list[tuple[float, ...]], columns: int) -> NDArray[np.float64]:
    array = np.array(rows, dtype=np.float64).reshape(-1, columns)
    array.setflags(write=False)
    return array
