"""`ogm build --each`: every log is mapped by itself, as logs of different buildings, into its own folder."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import typer

from ogm_core.errors import BadInput, OgmError
from ogm_services.commands.batch.tasks import Task
from ogm_services.commands.build import build_map, check_once, workers_of
from ogm_services.commands.build_request import BuildRequest
from ogm_services.results.map_folder import check_place


class LogsFailed(OgmError):
    """Some logs gave no map; each has been told of."""

    slug = "logs-failed"


class Built(NamedTuple):
    """What is to be told of a log that was mapped, or what kept it from that."""

    report: str
    warnings: list[str]
    error: str = ""
    bad_input: bool = False


def run_each(request: BuildRequest) -> None:
    """Map every log into a folder in `out` that is named after it, as `run_build` does.

    A log that gives no map is told of, and keeps none of the others from theirs.

    Raises:
        BadInput: two logs would have one folder, or it cannot be written; or all that is wrong is with logs.
        LogsFailed: some logs gave no map.
    """
    logs, out = request.logs, request.out
    check_once(logs)
    check_place(out)
    folders = folders_of(logs, out)
    if request.dask is not None:  # whose workers may be in other folders
        logs, folders = ([path.absolute() for path in paths] for paths in (logs, folders))
    alone = replace(request, workers=1, dask=None)
    tasks = [
        Task("build_log", (replace(alone, logs=(log,), out=folder),), str(log), __name__)
        for log, folder in zip(logs, folders, strict=True)
    ]
    others = workers_of(request)
    if others is None:
        told = [_tell(build_log(*task.arguments)) for task in tasks]
    else:
        with others as at_work:
            told = [_tell(built) for built in at_work.run("mapping logs", tasks)]
    failed = [built for built in told if built.error]
    if failed:
        kind = BadInput if all(built.bad_input for built in failed) else LogsFailed
        raise kind(f"{len(failed)} of {len(logs)} logs gave no map: see above")


def build_log(request: BuildRequest) -> Built:
    """Map a log by itself."""
    try:
        return Built(*build_map(request))
    except OgmError as error:
        return Built("", [], str(error), isinstance(error, BadInput))


def folders_of(logs: Sequence[Path], out: Path) -> list[Path]:
    """The folder of each log, named as it is without what its name ends in.

    Raises:
        BadInput: two logs would have the same.
    """
    names = [log.absolute().name.removesuffix(".gz") for log in logs]
    stems = [name if log.is_dir() else Path(name).stem for log, name in zip(logs, names, strict=True)]
    for number, stem in enumerate(stems):
        if stem in stems[:number]:
            raise BadInput(
                f"--each: {logs[stems.index(stem)]} and {logs[number]} would both be written into "
                f"{out / stem}: rename one of them, or map them one by one"
            )
    return [out / stem for stem in stems]


def _tell(built: Built) -> Built:
    """Tell of a log, and return what was told."""
    for line in built.warnings:
        typer.echo(line, err=True)
    if built.error:
        typer.echo(f"ogm: {' '.join(built.error.split())}", err=True)
    else:
        typer.echo(built.report)
    return built
