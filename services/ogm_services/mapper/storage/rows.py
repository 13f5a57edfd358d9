"""Rows of a store's tables: what is written into them, and read from them with every digest checked."""

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass

from ogm_core.cells.forgetting import MapTime
from ogm_core.errors import BadStore
from ogm_core.lattice import CellRect
from ogm_core.tiles.checkpoint import MapState, RobotState
from ogm_services.mapper.storage.digests import (
    Changes,
    Root,
    part_digest,
    settings_digest,
    state_digest,
)
from ogm_services.mapper.storage.layout import SECOND_VERSION, version_of

PLACING = "SELECT key, value, digest FROM placing"
_SINCE_VERSION_2 = {"time", "ticks", "erasures", "stretched"}
"""Of a map's state."""


@dataclass(frozen=True)
class StoredState:
    """What a store says of its map beside tiles and placing state."""

    map: MapState
    run: str
    """Of the process that stored it."""
    settings: str
    """Those that the map is made with (see map_settings)."""
    tiles: int
    """How many there are."""
    root: bytes


def check_pages(connection: sqlite3.Connection) -> None:
    """Let SQLite look at every page: what it does not read now it would stumble over later, or write over.

    Raises:
        BadStore: a page is damaged.
    """
    found = [str(text) for (text,) in connection.execute("PRAGMA integrity_check(1)")]
    if found != ["ok"]:
        raise BadStore(f"SQLite finds: {' '.join('; '.join(found).split())}")  # it says so in several lines


def read_state(connection: sqlite3.Connection) -> StoredState | None:
    """The state, and the settings; None of a store without a map.

    Raises:
        BadStore: a row of them is damaged, or is not there.
    """
    states = connection.execute("SELECT text, root, digest FROM state").fetchall()
    settings = connection.execute("SELECT text, digest FROM settings").fetchall()
    if not states and not settings:
        rows = sum(
            connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0]
            for table in ("tiles", "placing")
        )
        if rows:
            raise BadStore("there are tiles, and nothing that says of which map they are")
        return None
    if len(states) != 1 or len(settings) != 1:
        raise BadStore("there is not one row of settings and one of the map's state")
    ((text, root, digest),), ((settings_text, given),) = states, settings
    if not (_are((text, settings_text), str) and _are((root, digest, given), bytes)):
        raise BadStore("the row of its state or of its settings is damaged")
    if state_digest(text, root) != digest:
        raise BadStore("the row of its state is damaged")
    if settings_digest(settings_text) != given:
        raise BadStore("the row of its settings is damaged")
    return _state_of(text, settings_text, root)


def read_placing(connection: sqlite3.Connection, root: Root) -> dict[str, bytes]:
    """Every part of the placing state by its key, each put under `root`.

    Raises:
        BadStore: one of them is damaged.
    """
    parts = {}
    for key, value, digest in connection.execute(PLACING):
        if not (isinstance(key, str) and _are((value, digest), bytes) and part_digest(key, value) == digest):
            raise BadStore(f"the placing state of {str(key)[:100]!r} is damaged")
        root.put(key, digest)
        parts[key] = value
    return parts


def new_state(map_state: MapState, run: str, settings: str, root: Root) -> StoredState:
    """The state of a store that has these rows."""
    return StoredState(map_state, run, settings, root.tiles, root.with_settings(settings_digest(settings)))


def check_root(state: StoredState, root: Root) -> None:
    """Compare the rows that were read with the root.

    Raises:
        BadStore: one is missing, or older than the others.
    """
    if root.with_settings(settings_digest(state.settings)) != state.root:
        raise BadStore("tiles or placing state are missing, or older than the rest")


def write_placing(connection: sqlite3.Connection, parts: Mapping[str, bytes | None]) -> Changes:
    """Write parts of the placing state; what is None is there no more. Their digests."""
    digests: Changes = {}
    for key, value in parts.items():
        digests[key] = None if value is None else part_digest(key, value)
        if value is None:
            connection.execute("DELETE FROM placing WHERE key = ?", (key,))
        else:
            connection.execute("INSERT OR REPLACE INTO placing VALUES (?, ?, ?)", (key, value, digests[key]))
    return digests


def write_state(connection: sqlite3.Connection, state: StoredState) -> None:
    """Write settings and state, with the root over all rows.

    Without what the first version did not know it is such a store, that programs of then go on with.
    """
    fields = {"run": state.run, "tiles": state.tiles, **state.map._asdict(), **state.map.time._asdict()}
    if state.map.time == MapTime():
        del fields["time"], fields["ticks"]
    if not state.map.erasures:
        del fields["erasures"]
    if state.map.stretched is None:
        del fields["stretched"]
    if not state.map.robots:
        del fields["robots"]
    if fields.keys() & _SINCE_VERSION_2 and version_of(connection) < SECOND_VERSION:
        connection.execute(f"PRAGMA user_version = {SECOND_VERSION}")
    text = json.dumps(fields)
    digest = state_digest(text, state.root)
    connection.execute("INSERT OR REPLACE INTO state VALUES (1, ?, ?, ?)", (text, state.root, digest))
    connection.execute(
        "INSERT OR REPLACE INTO settings VALUES (1, ?, ?)",
        (state.settings, settings_digest(state.settings)),
    )


def _state_of(text: str, settings: str, root: bytes) -> StoredState:
    fields = json.loads(text)
    run, tiles, known = (fields.pop(name) for name in ("run", "tiles", "known"))
    room = CellRect(*fields.pop("room"))
    time, ticks = fields.pop("time", None), fields.pop("ticks", ())
    stretched, robots = fields.pop("stretched", None), fields.pop("robots", ())
    state = MapState(
        known=_rect_of(known),
        room=room,
        time=MapTime(time, tuple(ticks)),
        stretched=_rect_of(stretched),
        robots=tuple(
            RobotState(robot, since, _rect_of(its_known), CellRect(*its_room))
            for robot, since, its_known, its_room in robots
        ),
        **fields,
    )
    return StoredState(state, run, settings, tiles, root)


def _rect_of(numbers: list[int] | None) -> CellRect | None:
    return None if numbers is None else CellRect(*numbers)


def _are(values: object, kind: type) -> bool:
    return all(isinstance(value, kind) for value in values)  # type: ignore[attr-defined]
