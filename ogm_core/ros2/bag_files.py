"""Bags as files: rosbag2's folders and their data files (sqlite3, MCAP), and the .bag files of ROS 1.

rosbags reads them; whatever it says of one that is damaged becomes one line.
"""

import heapq
import re
from collections.abc import Collection, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace, TracebackType
from typing import Any, NamedTuple, Self

from ogm_core.errors import BadRecording, MissingExtra, cut, printable
from ogm_core.ros2 import cdr

METADATA = "metadata.yaml"
DATA_SUFFIXES = (".db3", ".mcap")
BAG_SUFFIXES = (".bag", *DATA_SUFFIXES)
_MAGIC = {b"#ROSBAG V": ".bag", b"SQLite format 3\0": ".db3", b"\x89MCAP0\r\n": ".mcap"}
_KINDS = {".bag": "ROS 1 bag", ".db3": "rosbag2, sqlite3", ".mcap": "rosbag2, MCAP"}
_OLD_NAMES = {"tf/msg/tfMessage": cdr.TF_MESSAGE}
"""What types were called before tf2."""


class BagTopic(NamedTuple):
    """A topic of a bag, with the number of its messages."""

    name: str
    type: str
    messages: int


class BagMessage(NamedTuple):
    """A message as it lies in a bag; `time` is when it was written, ns: it orders messages, and no more."""

    topic: BagTopic
    time: int
    payload: bytes


def is_bag(path: Path) -> bool:
    """Whether a path is to be read as a bag: by what it holds, or else by its name."""
    if path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return False
    return any(map(head.startswith, _MAGIC)) or path.suffix.lower() in BAG_SUFFIXES


class BagFile:
    """A bag, read in a `with`: its topics, and their messages in the order in which they were written.

    `kind` says what it is, `size` is that of its data files in bytes, `notes` what there is to say of how it
    is read. `start` and `end` are when its first and its last message were written, ns; 0 if it has none.

    Raises:
        BadRecording: on entering, it cannot be opened or is none; while messages are read, it is damaged.
        MissingExtra: rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.kind, self.size, self.start, self.end = "", 0, 0, 0
        self.topics: tuple[BagTopic, ...] = ()
        self.notes: list[str] = []
        self._ros1 = False
        self._readers: list[Any] = []
        self._opening = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            self._open(opening)
            self._opening = opening.pop_all()
        spans = [reader for reader in self._readers if reader.message_count]
        if spans:
            self.start = min(reader.start_time for reader in spans)
            self.end = max(reader.end_time for reader in spans) - 1
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opening.close()

    def messages(self, topics: Collection[BagTopic]) -> Iterator[BagMessage]:
        """The messages of some of its topics."""
        if topics:
            streams = [self._messages_of(reader, topics) for reader in self._readers]
            yield from heapq.merge(*streams, key=lambda message: message.time)

    def cdr(self, message: BagMessage) -> bytes:
        """A message as CDR.

        Raises:
            BadCdr: it is damaged.
        """
        if not self._ros1:
            return message.payload
        return cdr.from_ros1(message.payload, message.topic.type)

    def _open(self, opening: ExitStack) -> None:
        files = self._data_files()
        self.size = sum(file.stat().st_size for file in files)
        self.kind = _KINDS[files[0].suffix]
        self._ros1 = files[0].suffix == ".bag"
        for file in files:
            wal = file.with_name(f"{file.name}-wal")
            if wal.is_file() and wal.stat().st_size:
                self.notes.append(
                    f"{wal.name}: what it holds is not read: open {file.name} with sqlite3 once"
                )
        whole = self.path / METADATA
        if self.path.is_dir() and whole.is_file():
            try:
                self._readers = [self._opened(self.path, opening)]
            except BadRecording as error:
                self.notes.append(f"{METADATA} is of no use, its data files are read alone ({_cause(error)})")
        elif self.path.is_dir():
            self.notes.append(f"there is no {METADATA}: its data files are read alone")
        if not self._readers:
            self._readers = [self._opened(file, opening) for file in files]
        self.topics = self._listed()

    def _data_files(self) -> list[Path]:
        """The data files of the bag; of a folder those of one kind."""
        path = self.path
        try:
            if path.is_dir():
                found = [each for each in path.iterdir() if each.suffix in DATA_SUFFIXES and each.is_file()]
                if not found and (path / METADATA).is_file():
                    raise BadRecording(f"{path}: the folder of a bag without its data files (.db3, .mcap)")
                if not found:
                    raise BadRecording(f"{path}: a folder: give a log that is in it")
                return sorted((each for each in found if each.suffix == found[0].suffix), key=_by_number)
            with path.open("rb") as file:
                head = file.read(16)
        except OSError as error:
            raise BadRecording(f"{path}: cannot be read ({error.strerror})") from error
        if not head:
            raise BadRecording(f"{path}: empty, holds no scan")
        suffix = next((suffix for magic, suffix in _MAGIC.items() if head.startswith(magic)), None)
        if suffix is None:
            raise BadRecording(f"{path}: no bag, in spite of its name: it begins with {head[:8]!r}")
        if path.suffix != suffix:
            raise BadRecording(
                f"{path}: {_KINDS[suffix]} by its content, but not by its name: rename it to "
                f"{path.stem}{suffix}"
            )
        return [path]

    def _opened(self, path: Path, opening: ExitStack) -> Any:  # noqa: ANN401 - one of rosbags' readers
        rosbags = _rosbags()
        try:
            reader = rosbags.ros1(path) if path.suffix == ".bag" and path.is_file() else rosbags.ros2(path)
            reader.open()
        except MissingExtra:
            raise
        except Exception as error:
            raise self._damaged(path, error) from error
        opening.callback(_closed, reader)
        return reader

    def _listed(self) -> tuple[BagTopic, ...]:
        counts: dict[tuple[str, str], int] = {}
        for reader in self._readers:
            for connection in reader.connections:
                key = _key(connection)
                counts[key] = counts.get(key, 0) + connection.msgcount
        return tuple(BagTopic(name, kind, count) for (name, kind), count in sorted(counts.items()))

    def _messages_of(self, reader: Any, topics: Collection[BagTopic]) -> Iterator[BagMessage]:  # noqa: ANN401
        wanted = {(topic.name, topic.type): topic for topic in topics}
        connections = [each for each in reader.connections if _key(each) in wanted]
        if not connections:
            return
        try:
            for connection, stamp, payload in reader.messages(connections):
                yield BagMessage(wanted[_key(connection)], stamp, bytes(payload))
        except Exception as error:
            raise self._damaged(self.path, error) from error

    def _damaged(self, path: Path, error: Exception) -> BadRecording:
        if "end magic" in str(error):
            return BadRecording(f"{path}: an MCAP that was cut short: mcap recover makes a whole one of it")
        return BadRecording(f"{path}: a bag that is damaged, or of a kind that is not read ({_said(error)})")


def _key(connection: Any) -> tuple[str, str]:  # noqa: ANN401 - a tuple of rosbags
    kind = str(connection.msgtype)
    return str(connection.topic), _OLD_NAMES.get(kind, kind)


def _by_number(file: Path) -> tuple[int, str]:
    """Where a data file stands among those of a bag that was split: bag_10 after bag_9."""
    number = re.search(r"(\d+)$", file.stem)
    return (int(number[1]) if number else -1, file.name)


def _said(error: Exception) -> str:
    text = " ".join(printable(str(error)).split()) or "no reason is given"
    return f"{type(error).__name__}: {cut(text)}"


def _cause(error: BadRecording) -> str:
    cause = error.__cause__
    return _said(cause) if isinstance(cause, Exception) else str(error)


def _closed(reader: Any) -> None:  # noqa: ANN401 - one of rosbags' readers
    with suppress(Exception):  # what was read was read
        reader.close()


def _rosbags() -> SimpleNamespace:
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
    except ImportError as error:
        raise MissingExtra("bags need rosbags: pip install 'zenoh-ogm[ros2]'") from error
    return SimpleNamespace(ros1=Reader1, ros2=Reader2)
