"""Bags as files: rosbag2's folders and their data files (sqlite3, MCAP), and the .bag files of ROS 1.

rosbags reads them, and McapFile those of MCAP, which it reads even if they were cut short or hold more than
ROS's messages; whatever is said of one that is damaged becomes one line.
"""

import heapq
from collections.abc import Collection, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace, TracebackType
from typing import Any, NamedTuple, Self

from ogm_core.errors import BadRecording, MissingExtra, cut, printable
from ogm_core.ros2 import cdr
from ogm_core.ros2.bag_channel import BagChannel
from ogm_core.ros2.bag_folder import DATA_SUFFIXES, bag_folder
from ogm_core.ros2.cut_db3 import CutDb3, bytes_missing
from ogm_core.ros2.mcap_file import McapFile

BAG_SUFFIXES = (".bag", *DATA_SUFFIXES)
_MAGIC = {b"#ROSBAG V": ".bag", b"SQLite format 3\0": ".db3", b"\x89MCAP0\r\n": ".mcap"}
_KINDS = {".bag": "ROS 1 bag", ".db3": "rosbag2, sqlite3", ".mcap": "rosbag2, MCAP"}
_OLD_NAMES = {"tf/msg/tfMessage": cdr.TF_MESSAGE}
"""What types were called before tf2."""
_CDR, _ROS1 = "cdr", "ros1"
ENCODINGS = (_CDR, _ROS1)
"""How messages of ROS are written."""


class BagTopic(NamedTuple):
    """A topic of a bag, with the number of its messages; `encoding` is cdr or ros1, if they can be read."""

    name: str
    type: str
    messages: int
    encoding: str = _CDR


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
        if not path.is_file():
            return False  # what a pipe says is said once
        with path.open("rb") as file:
            head = file.read(16)
    except OSError:
        return False
    return any(map(head.startswith, _MAGIC)) or path.suffix.lower() in BAG_SUFFIXES


class BagFile:
    """A bag, read in a `with`: its topics, and their messages in the order in which they were written.

    `kind` says what it is, `size` is that of its data files in bytes, `notes` what there is to say of how it
    is read. `start` and `end` are when its first and its last message were written, ns; 0 if it has none.
    `others` are topics whose messages are not those of ROS, and cannot be read.

    Raises:
        BadRecording: on entering, it cannot be opened or is none; while messages are read, it is damaged.
        MissingExtra: rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.kind, self.size, self.start, self.end = "", 0, 0, 0
        self.topics: tuple[BagTopic, ...] = ()
        self.others: tuple[BagTopic, ...] = ()
        self.notes: list[str] = []
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
        if message.topic.encoding == _CDR:
            return message.payload
        return cdr.from_ros1(message.payload, message.topic.type)

    def _open(self, opening: ExitStack) -> None:
        files, packed = self._data_files()
        self.size = sum(file.stat().st_size for file in files)
        self.kind = _KINDS[next(kind for kind in files[0].suffixes[::-1] if kind in _KINDS)]
        for file in (file.with_name(f"{file.name}-{log}") for file in files for log in ("wal", "journal")):
            if file.is_file() and file.stat().st_size:
                self.notes.append(
                    f"{file.name}: not read, and it may hold messages: open the .db3 with sqlite3 once"
                )
        if packed:
            self._readers = [self._opened(self.path, opening)]
        else:
            self._readers = [self._opened(file, opening) for file in files]
        found = self._listed()
        self.topics = tuple(topic for topic in found if topic.encoding in ENCODINGS)
        self.others = tuple(topic for topic in found if topic.encoding not in ENCODINGS)
        if self.others:
            named = ", ".join(f"{topic.name} ({topic.messages}, {topic.encoding})" for topic in self.others)
            self.notes.append(f"not read, as they are no messages of ROS: {cut(printable(named))}")

    def _data_files(self) -> tuple[tuple[Path, ...], bool]:
        """The data files of the bag, all of one kind, and whether they are packed."""
        path = self.path
        try:
            if path.is_dir():
                folder = bag_folder(path)
                self.notes += folder.notes
                return folder.files, folder.packed
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
        return (path,), False

    def _opened(self, path: Path, opening: ExitStack) -> Any:  # noqa: ANN401 - one of rosbags' readers
        try:
            reader = self._reader(path, opening)
        except (BadRecording, MissingExtra):
            raise
        except OSError as error:
            raise BadRecording(f"{path}: cannot be read ({error.strerror})") from error
        except Exception as error:
            raise self._damaged(path, error) from error
        opening.callback(_closed, reader)
        return reader

    def _reader(self, path: Path, opening: ExitStack) -> Any:  # noqa: ANN401 - one of rosbags' readers
        """What reads a data file, or a folder whose files are packed; it raises whatever it likes."""
        kind = path.suffix if path.is_file() else ""
        if kind == ".mcap" or (kind == ".db3" and bytes_missing(path)):
            found = McapFile(path) if kind == ".mcap" else CutDb3(path)
            self.notes += [found.cut_short] if found.cut_short else []
            return found
        rosbags = _rosbags()
        reader = rosbags.ros1(path) if kind == ".bag" else rosbags.ros2(_plain(path, opening))
        reader.open()
        return reader

    def _listed(self) -> tuple[BagTopic, ...]:
        counts: dict[tuple[str, str, str], int] = {}
        for reader in self._readers:
            for connection in reader.connections:
                key = _key(connection)
                counts[key] = counts.get(key, 0) + connection.msgcount
        return tuple(BagTopic(*key[:2], count, key[2]) for key, count in sorted(counts.items()))

    def _messages_of(self, reader: Any, topics: Collection[BagTopic]) -> Iterator[BagMessage]:  # noqa: ANN401
        wanted = {(topic.name, topic.type, topic.encoding): topic for topic in topics}
        connections = [each for each in reader.connections if _key(each) in wanted]
        if not connections:
            return
        try:
            for connection, stamp, payload in reader.messages(connections):
                yield BagMessage(wanted[_key(connection)], stamp, bytes(payload))
        except BadRecording:
            raise
        except Exception as error:
            raise self._damaged(self.path, error) from error

    def _damaged(self, path: Path, error: Exception) -> BadRecording:
        text = f"{path}: a bag that is damaged, or of a kind that is not read ({_said(error)})"
        if path.suffix == ".bag" and "index" in str(error):
            text += "; one that was not closed gets its index by `rosbag reindex`"
        return BadRecording(text)


def _plain(path: Path, opening: ExitStack) -> Path:
    """A path, or a link to it if its name would be no name in a URI, which rosbags makes of it."""
    if not set("?#%").intersection(str(path)):
        return path
    link = Path(opening.enter_context(TemporaryDirectory()), f"bag{path.suffix}")
    link.symlink_to(path.absolute())
    return link


def _key(connection: Any) -> tuple[str, str, str]:  # noqa: ANN401 - a tuple of rosbags, or BagChannel
    """Its topic, type and encoding."""
    kind = str(connection.msgtype)
    if kind.count("/") == 1:
        kind = kind.replace("/", "/msg/")
    if isinstance(connection, BagChannel):
        encoding = connection.encoding
    else:
        encoding = getattr(connection.ext, "serialization_format", _ROS1)
    return str(connection.topic), _OLD_NAMES.get(kind, kind), str(encoding)


def _said(error: Exception) -> str:
    text = " ".join(printable(str(error)).split()) or "no reason is given"
    return f"{type(error).__name__}: {cut(text)}"


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
