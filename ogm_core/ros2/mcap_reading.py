"""MCAP recordings, read in the order of the file: whole ones, and those that were cut short."""

import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import BinaryIO, NamedTuple

from ogm_core.errors import BadRecording
from ogm_core.ros2 import mcap_records
from ogm_core.ros2.mcap_recording import ROBOT, SENSOR
from ogm_core.ros2.mcap_records import HEAD, MAGIC, MAX_CHUNK, DamagedRecord
from ogm_core.ros2.recording_messages import POSE, SCAN

_OURS = (POSE, SCAN)
_LOOK = 16 * 1024 * 1024
"""So many bytes of a file without a summary are looked at for messages of ours."""
_FOOTER = struct.Struct("<BQQQI8s")
"""The last record and the magic after it; where the summary begins is the first of its fields."""


class McapMessage(NamedTuple):
    """A message as it lies in a file; `time` is when it came, ns."""

    topic: str
    type: str
    time: int
    payload: bytes
    metadata: dict[str, str]


def is_whole(file: BinaryIO) -> bool:
    """Whether a file ends as an MCAP does that was finished."""
    file.seek(0, 2)
    if file.tell() < 2 * len(MAGIC):
        return False
    file.seek(-len(MAGIC), 2)
    return file.read() == MAGIC


def is_recording(file: BinaryIO) -> bool:
    """Whether a file is an MCAP with messages of ours.

    Raises:
        MissingExtra: what decompresses it is not installed.
    """
    file.seek(0)
    if file.read(len(MAGIC)) != MAGIC:
        return False
    try:
        names = list(_schemas_in(records_of_summary(file)))
        return any(name in _OURS for name in names or _schemas_in(_looked_at(McapRecords(file))))
    except BadRecording:
        return False


def robot_and_sensor(message: McapMessage) -> tuple[str, str | None]:
    """Whose message of ours it is, and of which sensor, None for a pose: by its channel or topic."""
    parts = message.topic.split("/")
    robot = message.metadata.get(ROBOT, parts[3] if len(parts) > 3 else "")
    if message.type == POSE:
        return robot, None
    return robot, message.metadata.get(SENSOR, parts[-1])


class McapRecords:
    """Reads an open file, once, in its order, up to its end or where it was cut.

    Raises, while iterating:
        BadRecording: a part of it is damaged.
        MissingExtra: what decompresses it is not installed.
    """

    def __init__(self, file: BinaryIO, size: int | None = None) -> None:
        """`size`: no more of it is read, bytes; None: all."""
        self._file = file
        self.whole = False
        """Whether its end was reached."""
        self.read = 0
        """Bytes of the file that were read whole."""
        end = file.seek(0, 2)
        self.size = end if size is None else size
        self._cut = False
        """Whether the chunk that was given last is cut."""
        self._finished = self.size == end and is_whole(file)

    def __iter__(self) -> Iterator[McapMessage]:
        """Its messages."""
        schemas: dict[int, str] = {}
        channels: dict[int, mcap_records.Channel] = {}
        for kind, record in self.records():
            try:
                if kind == mcap_records.SCHEMA:
                    number, name = mcap_records.schema(record)
                    schemas[number] = name
                elif kind == mcap_records.CHANNEL:
                    channel = mcap_records.channel(record)
                    channels[channel.id] = channel
                elif kind == mcap_records.MESSAGE:
                    yield _message(mcap_records.message(record), channels, schemas)
            except DamagedRecord as error:
                raise self._damaged(error) from error

    def records(self) -> Iterator[tuple[int, memoryview]]:
        """Its records by kind, those in chunks one by one."""
        for kind, record in self.chunks():
            if kind == mcap_records.CHUNK:
                yield from self.broken_up(record)
            else:
                yield kind, memoryview(record)

    def chunks(self) -> Iterator[tuple[int, bytes]]:
        """Its records by kind, chunks as they are, one that was cut, too; of the summary none."""
        at = len(MAGIC)
        while at + HEAD.size <= self.size:
            self._file.seek(at)
            kind, length = HEAD.unpack(self._file.read(HEAD.size))
            if not kind or length > self.size - at - HEAD.size:  # a disk has zeros for what it lost
                if kind == mcap_records.CHUNK and not self._finished:
                    self._cut = True
                    yield kind, self._file.read(min(self.size - at - HEAD.size, 2 * MAX_CHUNK))
                break
            if length > 2 * MAX_CHUNK:
                raise BadRecording(f"the record at byte {at} is damaged: it has {length} bytes")
            record = self._file.read(length)
            at += HEAD.size + length
            self.read = at
            if kind in (mcap_records.DATA_END, mcap_records.FOOTER):
                self.whole = self._finished
                return
            yield kind, record
        if self._finished:
            raise BadRecording(f"what follows byte {self.read} is damaged")

    def broken_up(self, chunk: bytes) -> Iterator[tuple[int, memoryview]]:
        """The records of the chunk that `chunks` gave last, by kind; of one that was cut the whole ones.

        Raises:
            BadRecording: it is damaged; none of its records is used.
        """
        try:
            data = mcap_records.chunk(chunk, whole=not self._cut)
            return iter(list(mcap_records.records_in(data, whole=not self._cut)))
        except DamagedRecord as error:
            if self._cut:
                return iter(())
            raise self._damaged(error) from error

    def _damaged(self, error: DamagedRecord) -> BadRecording:
        return BadRecording(f"what is before byte {self.read} is damaged: {error}")


def _message(
    message: mcap_records.Message, channels: dict[int, mcap_records.Channel], schemas: dict[int, str]
) -> McapMessage:
    channel = channels.get(message.channel)
    if channel is None:
        raise DamagedRecord(f"a message is of channel {message.channel}, which is not described")
    return McapMessage(
        channel.topic, schemas.get(channel.schema, ""), message.time, message.payload, channel.metadata
    )


def records_of_summary(file: BinaryIO) -> Iterator[tuple[int, memoryview]]:
    """The records of a whole file's summary by kind, as far as they can be read; none if it has none."""
    file.seek(0, 2)
    if file.tell() < _FOOTER.size or not is_whole(file):
        return
    file.seek(-_FOOTER.size, 2)
    end = file.tell()
    kind, _, start, *_ = _FOOTER.unpack(file.read(_FOOTER.size))
    if kind != mcap_records.FOOTER or not 0 < start < end or end - start > _LOOK:
        return
    file.seek(start)
    with suppress(DamagedRecord):
        yield from mcap_records.records_in(file.read(end - start))


def _schemas_in(records: Iterator[tuple[int, memoryview]]) -> Iterator[str]:
    """The names of the schemas among records, up to one that is damaged."""
    for kind, record in records:
        if kind == mcap_records.SCHEMA:
            try:
                yield mcap_records.schema(record)[1]
            except DamagedRecord:
                return


def _looked_at(records: McapRecords) -> Iterator[tuple[int, memoryview]]:
    """The records in the first _LOOK bytes, by kind."""
    for kind, record in records.records():
        if records.read > _LOOK:
            return
        yield kind, record
