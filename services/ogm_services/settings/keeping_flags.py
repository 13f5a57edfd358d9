"""Flags of settings that say how a map is kept: by which threads, stored where, and cut or not."""

from dataclasses import dataclass
from typing import Annotated

from ogm_services.settings.flags import SettingFlags, setting

Threads = Annotated[
    str | None,
    setting("mapper", "threads", "N", "Threads that update cells, of large scans; auto: all cores but one"),
]


@dataclass(frozen=True)
class ThreadFlags(SettingFlags):
    """Flags of who makes a map without a network."""

    section = "mapper"

    threads: Threads = None


@dataclass(frozen=True)
class MapperFlags(SettingFlags):
    """Flags of the mapper alone."""

    section = "mapper"

    threads: Threads = None

    data: Annotated[
        str | None,
        setting("mapper", "data", "DIR", "Store the map in this folder, and go on with the one in it"),
    ] = None
    start_map: Annotated[
        str | None,
        setting("mapper", "start_map", "FILE", "Start with this ROS map (YAML) or map.npz, on its lattice"),
    ] = None
    start_confidence: Annotated[
        str | None,
        setting("mapper", "start_confidence", "P", "Probability that the start map is right about a cell"),
    ] = None
    separate_robots: Annotated[
        bool,
        setting(
            *("mapper", "separate_robots", None),
            "Keep what each robot has seen apart, so that ogm forget can leave it out (cell model rate)",
        ),
    ] = False


@dataclass(frozen=True)
class SharesFlags(SettingFlags):
    """Which part of a map that is cut a mapper has."""

    section = "shares"

    index: Annotated[
        str | None, setting("shares", "index", "K", "Keep share K of a map that is cut, and answer as it")
    ] = None
    cuts_x: Annotated[
        str | None, setting("shares", "cuts_x", "METRES", "Cut the map at these x, separated by commas")
    ] = None
    cuts_y: Annotated[str | None, setting("shares", "cuts_y", "METRES", "Cut it at these y")] = None


@dataclass(frozen=True)
class GatewayFlags(SettingFlags):
    """How the map is cut that a gateway gathers."""

    section = "shares"

    cuts_x: Annotated[
        str | None, setting("shares", "cuts_x", "METRES", "Where the map is cut, as its mappers are told: x")
    ] = None
    cuts_y: Annotated[str | None, setting("shares", "cuts_y", "METRES", "The same: y")] = None
    gather_timeout: Annotated[
        str | None, setting("shares", "gather_timeout", "SECONDS", "How long a share may take to answer")
    ] = None
