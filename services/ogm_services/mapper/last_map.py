"""Last map of a mapper: the files that it leaves in `--out` when it ends, the map's before its figures."""

import logging
from pathlib import Path

import typer

from ogm_core.errors import MapEmpty
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.serving.answers import Answers
from ogm_services.results.map_folder import write_map, write_quality

FIGURES_TIME = 5.0
"""How long a mapper that has stopped computes figures of its map, s, at most."""

log = logging.getLogger(__name__)


class LastMap:
    """Writes into a folder; without one, nothing. One thread."""

    def __init__(self, out: Path | None) -> None:
        self._out = out
        self._final = False

    def write_map(self, live_map: LiveMap, *, working: bool) -> None:
        """Write the map: whoever runs out of patience with its figures has it.

        While its writer is still `working` it is the newest copy that is written, and a line says so.

        Raises:
            BadInput, DiskFull: the folder cannot be written.
        """
        if self._out is None:
            return
        snapshot = live_map.newest_copy if working else live_map.snapshot()
        if snapshot is None:
            typer.echo(
                f"ogm: the map's files are not written into {self._out}: the map is still in use", err=True
            )
            return
        try:
            write_map(self._out, snapshot, None)
        except MapEmpty:
            log.warning("the map has no known cell: nothing is written into %s", self._out)
            return
        if working:
            typer.echo(
                f"ogm: the map's files in {self._out} are of revision {snapshot.revision}: "
                "what came after it does not end",
                err=True,
            )
        self._final = not working

    def write_figures(self, answers: Answers, within: float) -> None:
        """Write the figures of the map that was written, those that take at most `within` s and FIGURES_TIME.

        Raises:
            BadInput, DiskFull: the folder cannot be written.
        """
        if self._out is None or not self._final:
            return
        within = min(FIGURES_TIME, max(within, 0.0))
        quality = answers.quality_fields(fresh=True, within=within)
        write_quality(self._out, quality)
        missing = quality.get("missing")
        if missing:
            log.warning(
                "%s: figures that take longer than %.1f s are left out of quality.json: %s",
                *(self._out, within, ", ".join(missing)),
            )
