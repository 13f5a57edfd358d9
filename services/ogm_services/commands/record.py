"""`ogm record`: what all robots of a map publish, into an MCAP file, until Ctrl-C."""

import logging
import math
import os
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

import typer
import zenoh

from ogm_client.errors import ClientError, NobodyAnswered
from ogm_client.session import open_session
from ogm_core.errors import BadInput, DiskFull, OgmError
from ogm_core.ros2.mcap_recording import MAP_FRAME, McapWriter, check_writable
from ogm_core.whole_files import NO_ROOM
from ogm_services.recorder.new_file import FLAG, check_new, new_file
from ogm_services.recorder.recorder import Recorder
from ogm_services.results.written import written
from ogm_services.ros2.map_fetch import MapFetch
from ogm_services.runtime.progress import progress_line
from ogm_services.settings.settings import Settings

LOOK_PERIOD = 0.25
"""How often is looked whether it goes well, s."""

log = logging.getLogger(__name__)


class RecordingRemoved(OgmError):
    """The file has no name any more, so that nobody can read what is recorded."""


def run_record(settings: Settings, out: Path) -> None:
    """Record until KeyboardInterrupt; then add the map, if a mapper serves one, and finish the file.

    Raises:
        BadInput: `out` is there already, or cannot be written; or an extra is missing.
        CannotConnect: there is no such host.
        DiskFull: there is no more room; what was written can be read.
        RecordingRemoved: somebody has removed the file.
    """
    check_writable()
    check_new(out)
    map_name = settings.network.map_name
    with ExitStack() as opening:
        config = replace(settings.network.for_client(), connect_timeout=math.inf)
        try:
            session = opening.enter_context(open_session(config))
        except KeyboardInterrupt:
            typer.echo(f"{out} is not made: neither a mapper nor a router was there")
            raise
        file = opening.enter_context(new_file(out))
        writer = _begun(out, file)
        recorder = Recorder(session, settings, writer)
        try:
            with recorder:
                typer.echo(f"recording map {map_name} into {out}: Ctrl-C ends it")
                _watch(recorder, file, out)
        except KeyboardInterrupt:
            pass
        failure, said = recorder.sink.failure, recorder.counted()
        if failure is None:
            try:
                _add_map(writer, session, map_name)
                writer.finish()
            except OSError as error:
                failure = error
        if failure is not None:
            raise _ended(out, said, failure) from failure
    typer.echo(f"{out}: {said}{'' if recorder.sink.robots else _nobody(map_name)}")


def _begun(out: Path, file: BinaryIO) -> McapWriter:
    """The writer of a new file, whose begin is written; a file that holds nothing is in nobody's way."""
    try:
        with written(out, FLAG):
            writer = McapWriter(file)
            writer.flush()
    except (BadInput, DiskFull):
        out.unlink(missing_ok=True)
        raise
    return writer


def _nobody(map_name: str) -> str:
    return f": no robot published to map {map_name}; robots and recorder need the same --map and address"


def _watch(recorder: Recorder, file: BinaryIO, out: Path) -> None:
    """Show how it goes, until a message cannot be written, or nobody could read it."""
    linked = os.fstat(file.fileno()).st_nlink > 0  # some file systems count no names
    # Signals may be handed to any thread; Python sees to them when the main thread wakes up.
    with progress_line() as show:
        while not threading.Event().wait(LOOK_PERIOD) and recorder.sink.failure is None:
            status = os.fstat(file.fileno())
            if linked and not status.st_nlink:
                raise RecordingRemoved(
                    f"{out}: was removed while it was written, and {recorder.counted()} with it; record anew"
                )
            show(f"{recorder.counted()}, {status.st_size / 1e6:.1f} MB")


def _add_map(writer: McapWriter, session: zenoh.Session, map_name: str) -> None:
    """Add the map as it is now, if there is one to be had; say so if not."""
    try:
        grid = MapFetch(session, map_name, MAP_FRAME).trinary()
    except NobodyAnswered:
        log.info("no mapper serves map %s, so the recording ends without one", map_name)
    except ClientError as error:
        log.warning("the recording ends without the map: %s", error)
    else:
        if grid is None:
            log.info("map %s is empty, so the recording ends without one", map_name)
        else:
            writer.map(grid, time.time_ns())


def _ended(out: Path, said: str, error: OSError) -> BadInput | DiskFull:
    """What ends a recording before its time."""
    kind = DiskFull if error.errno in NO_ROOM else BadInput
    return kind(
        f"{out}: cannot be written any more: {error.strerror or error}; at least {said} can be read; "
        f"ogm record --repair {out} makes it a whole file once there is room"
    )
