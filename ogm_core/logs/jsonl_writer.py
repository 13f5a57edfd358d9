"""JSON lines logs, written; it is light, without what reads logs, so that robots can write them."""

import gzip
import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from isal import igzip, isal_zlib

from ogm_core.errors import BadRecording, DiskFull
from ogm_core.logs.recorded import Recorded, RecordedPose
from ogm_core.types import Ranges
from ogm_core.whole_files import NO_ROOM, whole_file
from ogm_core.wire.messages import scan_fields

JSON_SUFFIXES = (".jsonl", ".jsonl.gz")


def to_line(recorded: Recorded) -> str:
    """JSON form of a message, without the line's end; `parse_line` gives the same message, bit for bit."""
    fields: dict[str, Any]
    if isinstance(recorded, RecordedPose):
        message = recorded.message
        fields = {"type": "pose", "robot": recorded.robot, "stamp": message.stamp, "seq": message.seq}
        fields |= {"run": message.run, **message.pose._asdict()}
    else:
        fields = {"type": "scan", "robot": recorded.robot, "sensor": recorded.sensor}
        fields |= scan_fields(recorded.message)
        fields["ranges"] = _short(recorded.message.ranges)
    return json.dumps(fields, allow_nan=False, separators=(",", ":"))


def write_jsonl(path: Path, messages: Iterable[Recorded]) -> None:
    """Write a JSON lines log, gzipped if `path` ends in .gz; equal messages give equal files.

    The file takes its name when it is complete: a failure on the way leaves what was there before.

    Raises:
        BadRecording: the name does not end in .jsonl or .jsonl.gz, or the file cannot be written.
        DiskFull: there is no room for it.
    """
    with jsonl_file(path) as write:
        for recorded in messages:
            write(recorded)


@contextmanager
def jsonl_file(path: Path) -> Iterator[Callable[[Recorded], None]]:
    """What writes one message after the other into a log, likewise.

    Raises:
        BadRecording, DiskFull: likewise.
    """
    if not path.name.lower().endswith(JSON_SUFFIXES):
        raise BadRecording(f"{path}: recordings are written as {' or '.join(JSON_SUFFIXES)}")
    if "\0" in str(path):
        raise BadRecording("a file's name holds no NUL character")
    if path.is_dir():
        raise BadRecording(f"{path}: cannot be written (it is a folder)")
    caller: BaseException | None = None
    try:
        with _written(path) as file:
            try:
                yield lambda recorded: _write(file, recorded, path)
            except BaseException as error:
                caller = error  # the file is not to blame for it
                raise
    except OSError as error:
        if error is caller:
            raise
        raise _failure(path, error) from error


def cannot(path: Path, what: str, error: OSError) -> str:
    """Why a file cannot be `what`: read, or written."""
    return f"{path}: cannot be {what} ({error.strerror or error})"


def _write(file: IO[bytes] | gzip.GzipFile, recorded: Recorded, path: Path) -> None:
    line = to_line(recorded).encode() + b"\n"
    try:
        file.write(line)
    except OSError as error:
        raise _failure(path, error) from error


def _failure(path: Path, error: OSError) -> BadRecording | DiskFull:
    kind = DiskFull if error.errno in NO_ROOM else BadRecording
    return kind(cannot(path, "written", error))


@contextmanager
def _written(path: Path) -> Iterator[IO[bytes] | gzip.GzipFile]:
    with whole_file(path) as file:
        if path.name.lower().endswith(".gz"):
            # No name and no time in the header: they would make equal recordings differ.
            with igzip.GzipFile("", "wb", isal_zlib.ISAL_BEST_COMPRESSION, file, 0) as stream:  # type: ignore[no-untyped-call]
                yield stream
        else:
            yield file


def _short(ranges: Ranges) -> list[float | str]:
    """Numbers of few digits that read as these float32: 0.1, where the float32 is 0.10000000149...

    The shortest text of a float32 is read by way of float64; where rounding twice gave a neighbour, all
    digits are kept.
    """
    short = ranges.astype(str).astype(np.float64)
    with np.errstate(over="ignore"):
        chosen = np.where(short.astype(np.float32) == ranges, short, ranges.astype(np.float64))
    return [value if math.isfinite(value) else str(value) for value in chosen.tolist()]
