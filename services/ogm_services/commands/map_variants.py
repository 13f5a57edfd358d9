"""Variants of a map by name: how a scan is read, and what a cell keeps."""

from collections.abc import Mapping
from typing import get_args

from ogm_core.errors import BadInput
from ogm_core.grid_settings import CellModelName, Traversal
from ogm_services.settings.settings import MapSettings, Settings

_LOG_ODDS = "log_odds"
VARIANTS: Mapping[str, Mapping[str, str]] = {
    **{
        traversal: {"cell_model": _LOG_ODDS, "sensor_model": "beam", "traversal": traversal}
        for traversal in get_args(Traversal)
    },
    "sector": {"cell_model": _LOG_ODDS, "sensor_model": "sector"},
    **{
        model: {"cell_model": model, "sensor_model": "beam"}
        for model in get_args(CellModelName)
        if model != _LOG_ODDS
    },
}
"""What each says in the settings of the map: log odds by traversal or sectors, and other cell models."""


def variant_of(settings: MapSettings) -> str:
    """The name of what the settings of a map say."""
    if settings.cell_model != _LOG_ODDS:
        return settings.cell_model
    return settings.sensor_model if settings.sensor_model == "sector" else settings.traversal


def variants(names: str | None, settings: Settings) -> dict[str, Settings]:
    """Settings by the variants' names, separated by commas; those given, if none are named.

    Raises:
        BadInput: there is no such variant.
    """
    if names is None:
        return {variant_of(settings.map): settings}
    wanted = [name.strip() for name in names.split(",")]
    for name in wanted:
        if name not in VARIANTS:
            raise BadInput(f"--models: {name!r} is none of {', '.join(VARIANTS)}")
    return {
        name: settings.model_copy(update={"map": settings.map.model_copy(update=dict(VARIANTS[name]))})
        for name in wanted
    }
