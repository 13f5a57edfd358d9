"""Settings that a map is made with, as stores keep and shares tell them: all that decides what cells become.

Left out are the limits (`max_cells` and the like): they decide which scans are taken, and may be raised; and
`free_below`, by which a map is shown.
`anchor` is what a map that it began with gave, and no setting: the store's is taken.
"""

import dataclasses
import json
from dataclasses import replace
from typing import Any

import numpy as np

from ogm_core.cells.model import CellModel, Plane
from ogm_core.errors import BadSetting, BadStore
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import SAME_RESOLUTION
from ogm_core.shares import Share
from ogm_core.tiles.store import TILE

_COMPARED = ("outside", "sensor_model", "traversal", "alpha", "reach", "clear_range", "half_life")
_OF_SHARE = ("cuts_x", "cuts_y", "index")
_OF_PART = ("resolution", "anchor", "planes", "tile", *_OF_SHARE)
"""What a part of a map tells beside."""
_ABSENT = {"separate_robots": False}
"""What is not there in the text stands for."""


def as_text(settings: GridSettings) -> str:
    """The settings as JSON."""
    fields = {
        "resolution": settings.resolution,
        "anchor": list(settings.lattice.anchor),
        "bounds": None if settings.bounds is None else list(settings.bounds),
        **{name: getattr(settings, name) for name in _COMPARED},
        **_of_model(settings.cell_model),
        **_of_share(settings.share),
    }
    if settings.separate_robots:
        fields["separate_robots"] = True
    if settings.clip is not None and settings.share is None:
        fields["clip"] = list(dataclasses.astuple(settings.clip))
    return json.dumps(fields)


def planes_in(text: str) -> tuple[Plane, ...]:
    """The planes of the map that has these settings.

    Raises:
        BadStore: they are not what `as_text` makes.
    """
    try:
        fields = json.loads(text)
        if fields["tile"] != TILE:
            raise BadStore(f"its tiles are {fields['tile']} cells wide, not {TILE}")
        return tuple(Plane(name, np.dtype(dtype), side) for name, dtype, side in fields["planes"])
    except (ValueError, TypeError, KeyError) as error:
        raise BadStore(f"its settings cannot be read: {error}") from error


def settings_as_stored(text: str, given: GridSettings, where: str, cure: str) -> GridSettings:
    """`given`, on the very lattice of the stored map; errors say `where` that is, and what the `cure` is.

    Raises:
        BadSetting: they contradict those that the map was made with; the text names each, with both values.
        BadStore: the stored settings cannot be read.
    """
    planes_in(text)
    stored, now = json.loads(text), json.loads(as_text(given))
    if _alike(stored.get("resolution"), now["resolution"]):
        now["resolution"] = stored["resolution"]
    now["anchor"] = stored.get("anchor")
    # Other planes come of another model, which says it better.
    apart = [name for name in {**stored, **now} if stored.get(name) != now.get(name)]
    contradictions = [
        f"{_name(name)} is {_shown(now.get(name, _ABSENT.get(name)))}, and there "
        f"{_shown(stored.get(name, _ABSENT.get(name)))}"
        for name in apart
        if name != "planes" or apart == ["planes"]
    ]
    if contradictions:
        raise BadSetting(
            f"{where}: the map that is stored there was made with other settings: "
            f"{'; '.join(contradictions)}: {cure}"
        )
    anchor = (0.0, 0.0) if given.bounds is not None else tuple(map(float, stored["anchor"]))
    return replace(given, resolution=stored["resolution"], anchor=(anchor[0], anchor[1]))


def made_otherwise(told: object, given: GridSettings) -> str | None:
    """What of the settings that a share tells, by `as_text`, contradicts `given`, in words; None: nothing.

    Not looked at is what is told beside: where cells lie, of which planes they are, and the cuts.
    """
    try:
        theirs, ours = json.loads(str(told)), json.loads(as_text(given))
        if theirs.get("cell_model") != ours["cell_model"]:
            return f"map.cell_model {_shown(theirs.get('cell_model'))}, and {_shown(ours['cell_model'])} here"
    except (ValueError, AttributeError, RecursionError):
        return "settings that cannot be read"
    apart = [name for name in {**theirs, **ours} if theirs.get(name) != ours.get(name)]
    said = [
        f"{_name(name)} {_shown(theirs.get(name))}, and {_shown(ours.get(name))} here"
        for name in apart
        if name not in _OF_PART
    ]
    return "; ".join(said) or None


def _of_model(model: CellModel) -> dict[str, Any]:
    constants: dict[str, Any] = {}
    if dataclasses.is_dataclass(model):
        names = (field.name for field in dataclasses.fields(model))
        constants = {name: getattr(model, name) for name in names if name != "free_below"}
    planes = [[plane.name, np.dtype(plane.dtype).name, plane.side] for plane in model.planes]
    return {"cell_model": type(model).__name__, **constants, "planes": planes, "tile": TILE}


def _of_share(share: Share | None) -> dict[str, Any]:
    """Of a share of a map that is cut, which it is, and of which cuts; of a whole map nothing."""
    if share is None:
        return {}
    return {"cuts_x": list(share.cuts.x), "cuts_y": list(share.cuts.y), "index": share.index}


def _name(field: str) -> str:
    """What a field is called among the settings."""
    section = "shares" if field in _OF_SHARE else "mapper" if field == "separate_robots" else "map"
    return f"{section}.{field}"


def _alike(stored: object, now: float) -> bool:
    return isinstance(stored, float) and abs(stored - now) <= SAME_RESOLUTION * now


def _shown(value: object) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value)
