"""Worlds by name: the built-in ones, and those of files."""

from collections.abc import Callable, Mapping
from pathlib import Path

from ogm_core.errors import BadWorld
from ogm_core.files.strict_yaml import read_text
from ogm_core.simulation.office import PLAN
from ogm_core.simulation.trajectories import Point
from ogm_core.simulation.worlds import World, fields_of, lab, load_world
from ogm_core.units import MEBIBYTE

MAX_WORLD_BYTES = 4 * MEBIBYTE
"""A longer file is not read; that of a warehouse, wall by wall, is an eighth of it."""


def office() -> World:
    """An office floor of 30 x 20 m; the robot visits every room without touching anything."""
    return load_world(PLAN)


BUILT_IN: Mapping[str, Callable[[], World]] = {"lab": lab, "office": office}
"""The worlds that have a name."""


def world_named(
    name_or_path: str, start: Point | None = None, *, tell: Callable[[str], None] = lambda _: None
) -> World:
    """The built-in world of that name, else that of the YAML file at that path: a world file, or a ROS map.

    `start`, m, is where in a ROS map the robot begins; other worlds say that themselves. `tell` is told, in
    one line, what of a ROS map is not as its file says (see `read_ros_map`).

    Raises:
        BadWorld: there is no such file, it cannot be read, it is not a world, or no robot can begin there.
        BadMapFile: it is a ROS map, but it or its picture is not what is needed.
    """
    if name_or_path in BUILT_IN:
        return _own_way(BUILT_IN[name_or_path](), start)
    known = ", ".join(BUILT_IN)
    try:
        text = read_text(Path(name_or_path), MAX_WORLD_BYTES)
    except FileNotFoundError as error:
        raise BadWorld(f"world {name_or_path!r}: no such file, nor a built-in world ({known})") from error
    except (OSError, ValueError) as error:
        raise BadWorld(
            f"world {name_or_path!r}: not a file that can be read ({error}), nor a built-in world ({known})"
        ) from error
    try:
        fields = fields_of(text)
        if "image" in fields:
            return _world_of_map(Path(name_or_path), start, tell)
        return _own_way(load_world(fields), start)
    except BadWorld as error:
        raise BadWorld(f"world {name_or_path!r}: {error}") from error


def _own_way(world: World, start: Point | None) -> World:
    if start is not None:
        raise BadWorld(f"start: it is for ROS maps; the world {world.name} has a path of its own")
    return world


def _world_of_map(path: Path, start: Point | None, tell: Callable[[str], None]) -> World:
    # Here, because what reads pictures and finds ways loads slowly, and other worlds need none of it.
    from ogm_core.files.ros_map_reader import read_ros_map
    from ogm_core.simulation.ros_map_world import world_of_map

    return world_of_map(read_ros_map(path, tell), path.stem, start)
