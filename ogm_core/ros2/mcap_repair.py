"""MCAP files made whole: what can be read of one that was cut short or is damaged, with a summary again."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from ogm_core.errors import BadRecording
from ogm_core.ros2.mcap_package import mcap_package
from ogm_core.ros2.mcap_reading import McapRecords


@dataclass
class Repaired:
    """What was kept of a file, and what was not."""

    types: Counter[str] = field(default_factory=Counter)
    """Messages that were kept, by type."""
    last: int = 0
    """When the last of them came, ns."""
    unread: int = 0
    """Bytes at the file's end that nobody can read."""
    damaged: int = 0
    """Chunks that are left out."""
    whole: bool = False
    """Whether there was nothing to repair."""


def repair(source: BinaryIO, target: BinaryIO) -> Repaired:
    """Write what can be read of an MCAP into `target`, in its order, whoever wrote it.

    Raises:
        MissingExtra: mcap is not installed.
        OSError: one cannot be read, or the other written.
    """
    records, copy = McapRecords(source), _Copy(target)
    found = copy.found
    try:
        for record in records.chunks():
            if not isinstance(record, mcap_package().Chunk):
                copy.put(record)
                continue
            try:
                inner = records.broken_up(record)
            except BadRecording:
                found.damaged += 1
                continue
            for each in inner:
                copy.put(each)
    except BadRecording:
        pass  # nobody can tell where the next record begins
    copy.finish()
    found.whole = records.whole and not found.damaged
    found.unread = 0 if records.whole else records.size - records.read
    return found


class _Copy:
    """A file that records are copied into; channels and schemas are numbered anew."""

    def __init__(self, target: BinaryIO) -> None:
        self.found = Repaired()
        self._mcap = mcap_package()
        self._writer = self._mcap.Writer(target)
        self._schemas: dict[int, int] = {0: 0}
        self._names: dict[int, str] = {}
        self._channels: dict[int, Any] = {}
        self._numbers: dict[int, int] = {}
        self._begun = False

    def put(self, record: Any) -> None:  # noqa: ANN401 - a record of mcap
        mcap, writer = self._mcap, self._writer
        if isinstance(record, mcap.Header) and not self._begun:
            writer.start(profile=record.profile, library=record.library)
            self._begun = True
        elif isinstance(record, mcap.Schema) and record.id not in self._schemas:
            self._schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            self._names[record.id] = record.name
        elif isinstance(record, mcap.Channel):
            self._channels.setdefault(record.id, record)
        elif isinstance(record, mcap.Message):
            self._put_message(record)
        elif isinstance(record, mcap.Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, mcap.Metadata):
            writer.add_metadata(record.name, record.metadata)

    def finish(self) -> None:
        self._writer.finish()

    def _put_message(self, message: Any) -> None:  # noqa: ANN401 - a record of mcap
        channel = self._channels.get(message.channel_id)
        if channel is None or channel.schema_id not in self._schemas:
            return  # what says of which it is was in a chunk that is damaged
        if channel.id not in self._numbers:
            schema = self._schemas[channel.schema_id]
            self._numbers[channel.id] = self._writer.register_channel(
                channel.topic, channel.message_encoding, schema, channel.metadata
            )
        self._writer.add_message(
            self._numbers[channel.id],
            log_time=message.log_time,
            publish_time=message.publish_time,
            sequence=message.sequence,
            data=message.data,
        )
        self.found.types[self._names.get(channel.schema_id, "")] += 1
        self.found.last = max(self.found.last, message.log_time)
