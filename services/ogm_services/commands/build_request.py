"""What `ogm build` is asked for: of which logs, how they are read, where the map goes, who works at it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ogm_services.commands.held_scans import ALL_MAPPED, HeldScans
from ogm_services.commands.log_readers import AS_IT_SAYS, ReadAs
from ogm_services.settings.settings import Settings


@dataclass(frozen=True, slots=True)
class BuildRequest:
    """A map of logs, in the folder `out`; or a map of each of them, in folders there."""

    logs: Sequence[Path]
    out: Path
    settings: Settings
    read_as: ReadAs = AS_IT_SAYS
    held: HeldScans = ALL_MAPPED
    """Scans that are kept out of the map, which is judged by them."""
    world: str | None = None
    """The truth by which the map is judged, a name or path as of `world_named`."""
    figure: Path | None = None
    """A file to draw the map in."""
    workers: int = 1
    """So many processes work at it; one is this process."""
    dask: str | None = None
    """Address of the scheduler whose workers work at it."""
