"""MCAP recordings, read in the order of the file: whole ones, and those that were cut short."""

from collections.abc import Iterator
from typing import Any, BinaryIO, NamedTuple

from ogm_core.errors import BadRecording, MissingExtra, cut, printable
from ogm_core.ros2.mcap_package import MAGIC, mcap_package
from ogm_core.ros2.mcap_recording import LIBRARY, ROBOT, SENSOR
from ogm_core.ros2.recording_messages import POSE, SCAN

_OURS = (POSE, SCAN)
_HEAD = 64
"""So many bytes hold what it says wrote it."""
_LOOK = 16 * 1024 * 1024
"""So many bytes of a file without a summary are looked at for messages of ours."""


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
        MissingExtra: it seems to be, and mcap is not installed.
    """
    file.seek(0)
    head = file.read(_HEAD)
    if not head.startswith(MAGIC):
        return False
    try:
        mcap = mcap_package()
    except MissingExtra:
        if LIBRARY.encode() in head:
            raise
        return False
    try:
        if is_whole(file):
            file.seek(0)
            summary = mcap.make_reader(file).get_summary()
            if summary is not None and summary.schemas:
                return any(schema.name in _OURS for schema in summary.schemas.values())
    except Exception:  # noqa: BLE001 (whatever a damaged summary makes of it: the records tell)
        pass
    return any(message.type in _OURS for message in _looked_at(McapRecords(file)))


def robot_and_sensor(message: McapMessage) -> tuple[str, str | None]:
    """Whose message of ours it is, and of which sensor, None for a pose: by its channel or topic."""
    parts = message.topic.split("/")
    robot = message.metadata.get(ROBOT, parts[3] if len(parts) > 3 else "")
    if message.type == POSE:
        return robot, None
    return robot, message.metadata.get(SENSOR, parts[-1])


class McapRecords:
    """Reads the messages of an open file, once, in its order, up to its end or where it was cut.

    Raises, while iterating:
        MissingExtra: mcap is not installed.
        BadRecording: a part of it is damaged.
    """

    def __init__(self, file: BinaryIO, size: int | None = None) -> None:
        """`size`: no more of it is read, bytes; None: all."""
        self._file = file
        self._mcap = mcap_package()
        self.whole = False
        """Whether its end was reached."""
        self.read = 0
        """Bytes of the file that were read whole."""
        self.size = file.seek(0, 2) if size is None else size
        self._finished = is_whole(file)

    def __iter__(self) -> Iterator[McapMessage]:
        schemas: dict[int, str] = {}
        channels: dict[int, Any] = {}
        for record in self.records():
            if isinstance(record, self._mcap.Schema):
                schemas[record.id] = record.name
            elif isinstance(record, self._mcap.Channel):
                channels[record.id] = record
            elif isinstance(record, self._mcap.Message):
                channel = channels.get(record.channel_id)
                if channel is None:
                    raise BadRecording("a message is of no channel")
                name = schemas.get(channel.schema_id, "")
                yield McapMessage(channel.topic, name, record.log_time, record.data, channel.metadata)

    def records(self) -> Iterator[Any]:
        """Its records, those in chunks one by one."""
        for record in self.chunks():
            if isinstance(record, self._mcap.Chunk):
                yield from self.broken_up(record)
            else:
                yield record

    def chunks(self) -> Iterator[Any]:
        """Its records, chunks as they are."""
        self._file.seek(0)
        stream = self._mcap.StreamReader(self._file, emit_chunks=True, record_size_limit=self.size)
        records = iter(stream.records)
        while True:
            try:
                record = next(records)
            except StopIteration:
                self.whole = True
                return
            except Exception as error:
                at_end = self._file.tell() >= self.size or isinstance(error, self._mcap.TooLong)
                if at_end and not self._finished:
                    return
                raise BadRecording(f"what follows byte {self.read} is damaged ({_said(error)})") from error
            if self._file.tell() > self.size:
                return
            self.read = self._file.tell()
            yield record

    def broken_up(self, chunk: Any) -> list[Any]:  # noqa: ANN401 - a record of mcap
        """The records of a chunk.

        Raises:
            BadRecording: it is damaged.
        """
        try:
            records: list[Any] = self._mcap.breakup_chunk(chunk, validate_crc=True)
        except Exception as error:
            raise BadRecording(f"the chunk before byte {self.read} is damaged ({_said(error)})") from error
        return records


def _looked_at(records: McapRecords) -> Iterator[McapMessage]:
    """The messages of the first _LOOK bytes."""
    try:
        for message in records:
            if records.read > _LOOK:
                return
            yield message
    except BadRecording:
        return


def _said(error: Exception) -> str:
    text = " ".join(printable(str(error)).split())
    return f"{type(error).__name__}: {cut(text)}" if text else type(error).__name__
