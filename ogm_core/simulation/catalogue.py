"""Worlds by name: the built-in ones, and those of files."""

from collections.abc import Callable, Mapping
from pathlib import Path

from ogm_core.errors import BadWorld
from ogm_core.simulation.office import PLAN
from ogm_core.simulation.worlds import World, fields_of, lab, load_world


def office() -> World:
    """An office floor of 30 x 20 m; the robot visits every room without touching anything."""
    return load_world(PLAN)


BUILT_IN: Mapping[str, Callable[[], World]] = {"lab": lab, "office": office}
"""The worlds that have a name."""


def world_named(name_or_path: str) -> World:
    """The built-in world of that name, else that of the YAML file at that path: a world file, or a ROS map.

    Raises:
        BadWorld: there is no such file, it cannot be read, or it is not a world.
        BadMapFile: it is a ROS map, but it or its picture is not what is needed.
    """
    if name_or_path in BUILT_IN:
        return BUILT_IN[name_or_path]()
    known = ", ".join(BUILT_IN)
    try:
        text = Path(name_or_path).read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise BadWorld(f"world {name_or_path!r}: no such file, nor a built-in world ({known})") from error
    except (OSError, ValueError) as error:
        raise BadWorld(
            f"world {name_or_path!r}: not a file that can be read ({error}), nor a built-in world ({known})"
        ) from error
    try:
        fields = fields_of(text)
        return _world_of_map(Path(name_or_path)) if "image" in fields else load_world(fields)
    except BadWorld as error:
        raise BadWorld(f"world {name_or_path!r}: {error}") from error


def _world_of_map(path: Path) -> World:
    # Here, because what reads pictures and finds ways loads slowly, and other worlds need none of it.
    from ogm_core.files.ros_map_reader import read_ros_map
    from ogm_core.simulation.ros_map_world import world_of_map

    return world_of_map(read_ros_map(path), path.stem)
