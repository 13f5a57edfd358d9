"""Recorded logs: what robots published, one message a line, read and written in file order.

JSON lines (jsonlines, jsonl_writer) are read and written, CARMEN logs (carmen) and pose graphs with laser
lines (g2o) are read. Times in a log may be wrong, repeated or zero, so the order of the lines is the order of
the messages: nothing is sorted.
"""

import gzip
import io
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, BinaryIO, Self

from ogm_core.errors import BadMessage, BadRecording, BadSetting
from ogm_core.logs.carmen import CarmenLog
from ogm_core.logs.carmen_lines import LASERS
from ogm_core.logs.carmen_mount import mount_of_laser
from ogm_core.logs.g2o import GraphLog
from ogm_core.logs.jsonl_writer import JSON_SUFFIXES, cannot, to_line, write_jsonl
from ogm_core.logs.jsonlines import JsonLog
from ogm_core.logs.lines import LongLine, lines_of, longest_line
from ogm_core.logs.recorded import ReadDecimals, Recorded, RecordedPose, RecordedScan
from ogm_core.logs.renaming import Renaming, check_range_max
from ogm_core.logs.sniff import (
    BOM,
    CARMEN_SUFFIXES,
    G2O_SUFFIXES,
    HEAD,
    OF_GRAPH,
    folder,
    hint,
    kind_of_text,
    unpacked,
    why_not,
)
from ogm_core.logs.unpacking import GzipContent
from ogm_core.types import IDENTITY
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS

__all__ = [
    "CARMEN_SUFFIXES",
    "G2O_SUFFIXES",
    "JSON_SUFFIXES",
    "Recorded",
    "RecordedPose",
    "RecordedScan",
    "RecordingReader",
    "read_lines",
    "to_line",
    "write_jsonl",
]

MAX_COMPLAINTS = 5
"""How many malformed lines a reader quotes; it counts them all."""
_QUOTED = 200  # characters of a complaint: a line may hold anything, at any length
_SHOWN = 8  # names of messages that are not read
_BUFFER = 128 * 1024  # bytes of a log's text that are unpacked at once

Complain = Callable[[int, str], None]
"""Called with the number of a malformed line, from 1, and what is wrong with it."""


Parse = Callable[[bytes], Recorded | None]
"""Reads one line: its message, or None if none is read; raises BadMessage if the line is malformed."""


def read_lines(lines: Iterable[bytes], parse: Parse, complain: Complain) -> Iterator[Recorded]:
    """Messages of a log's lines; a malformed line goes to `complain` and is passed over."""
    for number, line in enumerate(lines, 1):
        if isinstance(line, LongLine):
            complain(number, "it is longer than any line of a scan can be: 24 bytes a beam, up to max_beams")
            continue
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
    replaces that of every scan; `robot` renames the log's one robot. With `odometry` the ODOM lines of a
    CARMEN log are the poses, and its scans carry none; such a log is read twice. `decimals`, as of
    decimals.read_decimals, reads the ranges of a CARMEN log faster, and the same.

    `scans` and `poses` count what was read so far, `malformed` the lines that were passed over, and
    `complaints` says what was wrong with the first of them. `size` is the file's size on disk in bytes.

    Raises:
        BadSetting: `range_max` or `robot` cannot be used.
        BadRecording: on entering, the file cannot be opened, is of no format that is read, or lacks what
            `odometry` needs; while iterating, it is truncated or corrupt, or holds a second robot although
            `robot` is given; at the end, it held no scan.
    """

    def __init__(
        self,
        path: Path,
        *,
        range_max: float | None = None,
        robot: str | None = None,
        odometry: bool = False,
        max_beams: int = DEFAULT_MAX_BEAMS,
        decimals: ReadDecimals | None = None,
    ) -> None:
        check_range_max(range_max)
        self.path, self.unit = path, "lines"
        self.malformed = self.scans = self.poses = self.size = 0
        self.complaints: list[str] = []
        self._range_max = range_max
        self._max_beams = max_beams
        self._odometry = odometry
        self._decimals = decimals
        self._renaming = Renaming(path, robot)
        self._file: BinaryIO | None = None
        self._position = 0
        self._head = b""
        self._carmen: CarmenLog | None = None
        self._graph: GraphLog | None = None

    @property
    def position(self) -> int:
        """Bytes of the file on disk that have been read, of `size`."""
        return self._position if self._file is None else self._file.tell()

    @property
    def not_read(self) -> str:
        """The laser messages of a CARMEN log that were passed over, as "20 RLASER"; "" if there were none."""
        return "" if self._carmen is None else self._carmen.lasers_passed_over()

    @property
    def doubt(self) -> str:
        """What in a CARMEN log contradicts how it is read; "" if nothing does."""
        return "" if self._carmen is None else self._carmen.doubt

    def __enter__(self) -> Self:
        file = self._opened()
        try:
            self._begin(file)
        except BaseException:
            file.close()
            self._file = None
            raise
        return self

    def _opened(self) -> BinaryIO:
        try:
            return self.path.open("rb")
        except IsADirectoryError as error:
            is_bag = any(entry.name == "metadata.yaml" for entry in self.path.iterdir())
            raise BadRecording(f"{self.path}: {folder(is_bag=is_bag)}") from error
        except OSError as error:
            raise BadRecording(cannot(self.path, "read", error)) from error

    def _begin(self, file: BinaryIO) -> None:
        """Refuse what is not read, and get ready for the first line."""
        try:
            self.size = os.fstat(file.fileno()).st_size
            self._head = file.read(HEAD)
            file.seek(0)
        except OSError as error:
            raise BadRecording(cannot(self.path, "read", error)) from error
        refusal = why_not(self.path.name, self._head)
        if refusal is not None:
            raise BadRecording(f"{self.path}: {refusal}")
        self._file = file
        if self._named(CARMEN_SUFFIXES) or (self._named(G2O_SUFFIXES) and not self._odometry):
            self._carmen = self._carmen_log(file)
        elif self._odometry:
            raise BadRecording(
                f"{self.path}: --odometry is for CARMEN logs, whose ODOM lines it reads; leave it out"
            )

    def _carmen_log(self, file: BinaryIO) -> CarmenLog:
        log = partial(
            CarmenLog, range_max=self._range_max, max_beams=self._max_beams, decimals=self._decimals
        )
        if not self._odometry:
            return log()
        try:
            mount = mount_of_laser(self._lines(), log(mount=IDENTITY))
        except BadSetting as error:
            raise BadRecording(f"{self.path}: {error}") from error
        file.seek(0)
        return log(mount=mount)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._position = self._file.tell()
            self._file.close()
            self._file = None

    def __iter__(self) -> Iterator[Recorded]:
        for recorded in read_lines(self._lines(), self._parse(), self._complain):
            renamed = self._renaming.of(recorded)
            if isinstance(recorded, RecordedScan):
                self.scans += 1
            else:
                self.poses += 1
            yield renamed
        if not self.scans:
            raise BadRecording(f"{self.path}: holds no scan{self._instead()}")

    def _parse(self) -> Parse:
        if self._carmen is None:
            return JsonLog(range_max=self._range_max, max_beams=self._max_beams).parse_line
        if self._odometry:
            return self._carmen.parse_line
        is_graph = self._named(G2O_SUFFIXES) or kind_of_text(unpacked(self._head)) == "g2o"
        self._graph = GraphLog(self._carmen, is_graph=is_graph or None)
        return self._graph.parse_line

    def _lines(self) -> Iterator[bytes]:
        if self._file is None:
            raise ValueError("a RecordingReader is read inside its `with`")
        lines: IO[bytes] = self._file
        if self._named((".gz",)):
            lines = io.BufferedReader(GzipContent(self._file), _BUFFER)
        try:
            rest = lines_of(lines, longest_line(self._max_beams))
            first = next(rest, b"")
            yield first if isinstance(first, LongLine) else first.removeprefix(BOM)
            yield from rest
        except EOFError as error:
            raise BadRecording(f"{self.path}: truncated, its gzip stream ends too early") from error
        except gzip.BadGzipFile as error:
            raise BadRecording(f"{self.path}: not gzip, or corrupt ({error})") from error
        except OSError as error:
            raise BadRecording(cannot(self.path, "read", error)) from error

    def _named(self, suffixes: tuple[str, ...]) -> bool:
        return self.path.name.lower().endswith(suffixes)

    def _complain(self, number: int, reason: str) -> None:
        self.malformed += 1
        if len(self.complaints) < MAX_COMPLAINTS:
            shown = reason if len(reason) <= _QUOTED else reason[:_QUOTED] + "..."
            self.complaints.append(f"line {number}: {shown}")

    def _instead(self) -> str:
        if self._graph is not None and self._graph.is_graph and not self.malformed:
            return f"; it is a g2o pose graph without ROBOTLASER1 lines: {OF_GRAPH}"
        text = f", only {self.poses} poses" if self.poses else ""
        if self.malformed:
            text += f"; {self.malformed} lines are malformed, first {self.complaints[0]}"
        if self._carmen is not None and self._carmen.unread:
            text += f"; found are {_listed(self._carmen.unread)}; read are {' and '.join(LASERS)}"
        return text + hint(self.path.name, self._head)


def _listed(counts: Counter[str]) -> str:
    shown = [f"{count} {name}" for name, count in counts.most_common(_SHOWN)]
    return ", ".join(shown) + (" and others" if len(counts) > _SHOWN else "")
