"""Recorded logs: what robots published, one message a line, read and written in file order.

JSON lines (ogm_core.jsonlines) are read and written, CARMEN logs (ogm_core.carmen) are read. Times in a log
may be wrong, repeated or zero, so the order of the lines is the order of the messages: nothing is sorted.
"""

import gzip
import os
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, BinaryIO, Self

from ogm_core import carmen, jsonlines
from ogm_core.errors import BadMessage, BadRecording, BadSetting
from ogm_core.jsonlines import to_line
from ogm_core.keys import check_name
from ogm_core.messages import DEFAULT_MAX_BEAMS, MAX_RANGE
from ogm_core.recorded import Recorded, RecordedPose, RecordedScan

__all__ = [
    "CARMEN_SUFFIXES",
    "JSON_SUFFIXES",
    "Recorded",
    "RecordedPose",
    "RecordedScan",
    "RecordingReader",
    "read_carmen",
    "read_jsonl",
    "to_line",
    "write_jsonl",
]

JSON_SUFFIXES = (".jsonl", ".jsonl.gz")
CARMEN_SUFFIXES = (".log", ".log.gz", ".clf", ".clf.gz")
MAX_COMPLAINTS = 5
"""How many malformed lines a reader quotes; it counts them all."""
_QUOTED = 200  # characters of a complaint: a line may hold anything, at any length

Complain = Callable[[int, str], None]
"""Called with the number of a malformed line, from 1, and what is wrong with it."""


def read_jsonl(
    lines: Iterable[bytes],
    complain: Complain,
    *,
    range_max: float | None = None,
    max_beams: int = DEFAULT_MAX_BEAMS,
) -> Iterator[Recorded]:
    """Messages of a JSON lines log; `range_max` (m) replaces that of every scan.

    A malformed line goes to `complain` and is passed over.
    """
    return _read(
        lines, complain, lambda line: jsonlines.parse_line(line, range_max=range_max, max_beams=max_beams)
    )


def read_carmen(
    lines: Iterable[bytes],
    complain: Complain,
    *,
    range_max: float | None = None,
    max_beams: int = DEFAULT_MAX_BEAMS,
) -> Iterator[Recorded]:
    """Messages of a CARMEN log, likewise."""
    return _read(
        lines, complain, lambda line: carmen.parse_line(line, range_max=range_max, max_beams=max_beams)
    )


def _read(
    lines: Iterable[bytes], complain: Complain, parse: Callable[[bytes], Recorded | None]
) -> Iterator[Recorded]:
    for number, line in enumerate(lines, 1):
        try:
            recorded = parse(line)
        except BadMessage as error:
            complain(number, str(error))
            continue
        if recorded is not None:
            yield recorded


class RecordingReader:
    """Reads a log of any known format, once, in file order.

    Use it in a `with`, and iterate over it there: it yields RecordedPose and RecordedScan. `range_max` (m)
    replaces that of every scan; `robot` renames the log's one robot.

    `scans` and `poses` count what was read so far, `malformed` the lines that were passed over, and
    `complaints` says what was wrong with the first of them. `size` is the file's size on disk in bytes.

    Raises:
        BadSetting: `range_max` or `robot` cannot be used.
        BadRecording: on entering, the file cannot be opened or its format is not read; while iterating, it
            is truncated or corrupt, or holds a second robot although `robot` is given; at the end, it held
            no scan.
    """

    def __init__(
        self,
        path: Path,
        *,
        range_max: float | None = None,
        robot: str | None = None,
        max_beams: int = DEFAULT_MAX_BEAMS,
    ) -> None:
        if range_max is not None and not 0.0 < range_max <= MAX_RANGE:
            raise BadSetting(f"range-max: above 0 and at most {MAX_RANGE:g} m is needed, got {range_max:g}")
        if robot is not None:
            check_name(robot, "robot")
        self.path = path
        self.malformed = self.scans = self.poses = self.size = 0
        self.complaints: list[str] = []
        self._range_max = range_max
        self._max_beams = max_beams
        self._new_name = robot
        self._old_name: str | None = None
        self._file: BinaryIO | None = None
        self._position = 0

    @property
    def position(self) -> int:
        """Bytes of the file on disk that have been read, of `size`."""
        return self._position if self._file is None else self._file.tell()

    def __enter__(self) -> Self:
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise BadRecording(_cannot(self.path, "read", error)) from error
        if not self._named(JSON_SUFFIXES + CARMEN_SUFFIXES):
            file.close()
            raise BadRecording(
                f"{self.path}: not a format that is read; these are JSON lines ({', '.join(JSON_SUFFIXES)}) "
                f"and CARMEN ({', '.join(CARMEN_SUFFIXES)}); .mcap, .db3 and .bag are not"
            )
        self._file = file
        self.size = os.fstat(file.fileno()).st_size
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._position = self._file.tell()
            self._file.close()
            self._file = None

    def __iter__(self) -> Iterator[Recorded]:
        read = read_jsonl if self._named(JSON_SUFFIXES) else read_carmen
        messages = read(self._lines(), self._complain, range_max=self._range_max, max_beams=self._max_beams)
        for recorded in messages:
            renamed = self._rename(recorded)
            if isinstance(recorded, RecordedScan):
                self.scans += 1
            else:
                self.poses += 1
            yield renamed
        if not self.scans:
            raise BadRecording(f"{self.path}: holds no scan{self._instead()}")

    def _lines(self) -> Iterator[bytes]:
        if self._file is None:
            raise ValueError("a RecordingReader is read inside its `with`")
        lines: IO[bytes] | gzip.GzipFile = self._file
        if self._named((".gz",)):
            lines = gzip.GzipFile(fileobj=self._file, mode="rb")
        try:
            for line in lines:  # noqa: UP028 (`yield from` would close the file along with this generator)
                yield line
        except EOFError as error:
            raise BadRecording(f"{self.path}: truncated, its gzip stream ends too early") from error
        except (gzip.BadGzipFile, zlib.error) as error:
            raise BadRecording(f"{self.path}: not gzip, or corrupt ({error})") from error
        except OSError as error:
            raise BadRecording(_cannot(self.path, "read", error)) from error

    def _named(self, suffixes: tuple[str, ...]) -> bool:
        return self.path.name.lower().endswith(suffixes)

    def _complain(self, number: int, reason: str) -> None:
        self.malformed += 1
        if len(self.complaints) < MAX_COMPLAINTS:
            shown = reason if len(reason) <= _QUOTED else reason[:_QUOTED] + "..."
            self.complaints.append(f"line {number}: {shown}")

    def _rename(self, recorded: Recorded) -> Recorded:
        if self._new_name is None:
            return recorded
        if self._old_name is None:
            self._old_name = recorded.robot
        if recorded.robot != self._old_name:
            raise BadRecording(
                f"{self.path}: holds robots {self._old_name} and {recorded.robot}; --robot renames one robot "
                "only, so leave it out or split the log"
            )
        return replace(recorded, robot=self._new_name)

    def _instead(self) -> str:
        if self.malformed:
            return f"; {self.malformed} lines are malformed, first {self.complaints[0]}"
        return f", only {self.poses} poses" if self.poses else ""


def write_jsonl(path: Path, messages: Iterable[Recorded]) -> None:
    """Write a JSON lines log, gzipped if `path` ends in .gz; equal messages give equal files.

    The file takes its name when it is complete: a failure on the way leaves what was there before.

    Raises:
        BadRecording: the name does not end in .jsonl or .jsonl.gz, or the file cannot be written.
    """
    if not path.name.lower().endswith(JSON_SUFFIXES):
        raise BadRecording(f"{path}: recordings are written as {' or '.join(JSON_SUFFIXES)}")
    if path.is_dir():
        raise BadRecording(f"{path}: cannot be written (it is a folder)")
    part = path.with_name(path.name + ".part")
    try:
        try:
            with _written(part, packed=path.name.lower().endswith(".gz")) as file:
                for recorded in messages:
                    file.write(to_line(recorded).encode() + b"\n")
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise BadRecording(_cannot(path, "written", error)) from error


@contextmanager
def _written(path: Path, *, packed: bool) -> Iterator[IO[bytes] | gzip.GzipFile]:
    with path.open("wb") as file:
        if packed:
            # No name and no time in the header: they would make equal recordings differ.
            with gzip.GzipFile(filename="", mode="wb", compresslevel=6, fileobj=file, mtime=0) as stream:
                yield stream
        else:
            yield file


def _cannot(path: Path, what: str, error: OSError) -> str:
    return f"{path}: cannot be {what} ({error.strerror or error})"
