"""Data files of rosbag2 (sqlite3) that were cut short: their messages, as far as they go."""

import sqlite3
import struct
from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

import numpy as np

from ogm_core.errors import BadRecording
from ogm_core.ros2.bag_channel import BagChannel

_HEADER = 100


def bytes_missing(path: Path) -> int:
    """How many bytes a database is shorter than it says.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        header = file.read(_HEADER)
    if len(header) < _HEADER:
        return _HEADER - len(header)
    page, changes, pages, valid_for = struct.unpack(">16xH6xII60xI4x", header)
    if changes != valid_for:  # it was written by a version that did not keep the number
        return 0
    return int(max(0, pages * (65_536 if page == 1 else page) - path.stat().st_size))


class CutDb3:
    """A database that lacks its end. It is read as by a Reader of rosbags, and `cut_short` says how far."""

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            BadRecording: not even its first message is there.
        """
        self.path = path
        self.start_time = self.end_time = self.message_count = 0
        name = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
        self._database = sqlite3.connect(name, uri=True, check_same_thread=False)
        self._times, self._numbers, self._of_topics = array("q"), array("q"), array("q")
        """Of each message that is there."""
        self._topics: list[tuple[int, str, str, str]] = []
        with suppress(sqlite3.Error):  # where the file ends
            self._scan()
        self.message_count = len(self._of_topics)
        if not self.message_count:
            self.close()
            raise BadRecording(f"{path}: a database that was cut short before its first message")
        self.start_time, self.end_time = min(self._times), max(self._times) + 1
        size, missing = path.stat().st_size, bytes_missing(path)
        read = f"{self.message_count} messages, {size} of {size + missing} bytes"
        self.cut_short = f"{path.name} was cut short, and is read as far as it goes: {read}"

    @property
    def connections(self) -> tuple[BagChannel, ...]:
        """Its topics."""
        counts = Counter(self._of_topics)
        return tuple(BagChannel(*each, counts[each[0]]) for each in self._topics)

    def messages(self, topics: Collection[BagChannel]) -> Iterator[tuple[BagChannel, int, bytes]]:
        """The messages of some topics by the times at which they were written, which are the numbers."""
        wanted = {topic.id: topic for topic in topics}
        for at in np.argsort(np.array(self._times), kind="stable").tolist():
            topic = wanted.get(self._of_topics[at])
            if topic is not None:
                number = (self._numbers[at],)
                found = self._database.execute("SELECT data FROM messages WHERE id = ?", number)
                yield topic, self._times[at], bytes(found.fetchone()[0])

    def close(self) -> None:
        """Read no more."""
        self._database.close()

    def _scan(self) -> None:
        # Else SQLite refuses a file of which a page is missing, whichever is asked for.
        self._database.execute("PRAGMA writable_schema = ON")
        self._topics = self._database.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        ).fetchall()
        # In the order of their numbers, as they were written; indices may lead past the end. The data are
        # looked at, since those of a message may lie elsewhere than the rest of it.
        for number, topic, time, _ in self._database.execute(
            "SELECT id, topic_id, timestamp, data FROM messages NOT INDEXED ORDER BY id"
        ):
            if not (isinstance(time, int) and isinstance(topic, int)):
                return  # what follows is no more to be trusted than this
            self._times.append(time)
            self._numbers.append(number)
            self._of_topics.append(topic)
