"""`ogm record --repair`: a recording that was cut short, or is damaged, becomes a whole file again."""

import fcntl
from datetime import UTC, datetime
from pathlib import Path

from ogm_core.errors import BadInput, BadRecording, DiskFull
from ogm_core.logs.jsonl_writer import cannot
from ogm_core.ros2.mcap_records import MAGIC
from ogm_core.ros2.mcap_repair import Repaired, repair
from ogm_core.ros2.recording_messages import POSE, SCAN
from ogm_core.whole_files import NO_ROOM, whole_file


class NothingToRepair(Exception):
    """The file is whole, and stays as it is."""


def repair_recording(path: Path) -> str:
    """Put a whole file in the place of one that is not, once it is complete; say what was kept.

    Raises:
        BadRecording: it is no MCAP, or nothing of it can be read; it stays as it is.
        BadInput: it is being recorded, or cannot be read or written.
        DiskFull: there is no room for a second one beside it.
        MissingExtra: mcap, or what decompresses the file, is not installed.
    """
    try:
        with path.open("rb") as source:
            _claim(path, source.fileno())
            if source.read(len(MAGIC)) != MAGIC:
                raise BadRecording(f"{path}: no MCAP file: it does not begin as one")
            with whole_file(path) as target:
                found = repair(source, target)
                _check(path, found)
    except NothingToRepair:
        return f"{path}: is whole, with {_kept(found)}; it stays as it is"
    except OSError as error:
        kind = DiskFull if error.errno in NO_ROOM else BadInput
        raise kind(cannot(path, "repaired", error)) from error
    until = datetime.fromtimestamp(found.last / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    left_out = [f"{found.damaged} damaged chunks are left out"] if found.damaged else []
    if found.undescribed:
        left_out.append(f"{found.undescribed} messages whose description is damaged are left out")
    left_out += [f"of its last {found.unread} bytes is kept what can be read"] if found.unread else []
    return "; ".join([f"{path}: is whole again, with {_kept(found)}, the last of {until}", *left_out])


def _check(path: Path, found: Repaired) -> None:
    """Let the file stay as it is if that is best."""
    if found.whole:
        raise NothingToRepair
    if not found.types:
        raise BadRecording(f"{path}: no message in it can be read; it stays as it is")


def _claim(path: Path, number: int) -> None:
    """Make sure that nobody records into a file."""
    try:
        fcntl.flock(number, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise BadInput(f"{path}: is being recorded: end `ogm record` first") from error
    except OSError:
        return  # a file system without locks


def _kept(found: Repaired) -> str:
    ours = f" ({found.types[SCAN]} scans and {found.types[POSE]} poses)" if found.types[SCAN] else ""
    return f"{found.types.total()} messages{ours}"
