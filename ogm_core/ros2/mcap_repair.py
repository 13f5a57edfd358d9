"""MCAP files made whole: what can be read of one that was cut short or is damaged, with a summary again."""

from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from ogm_core.errors import BadRecording
from ogm_core.ros2 import mcap_records
from ogm_core.ros2.mcap_package import mcap_package
from ogm_core.ros2.mcap_reading import McapRecords, records_of_summary


@dataclass
class Repaired:
    """What was kept of a file, and what was not."""

    types: Counter[str] = field(default_factory=Counter)
    """Messages that were kept, by type."""
    last: int = 0
    """When the last of them came, ns."""
    unread: int = 0
    """Bytes at the file's end of which no more than a part can be read."""
    damaged: int = 0
    """Chunks, and records outside of them, that are left out."""
    undescribed: int = 0
    """Messages that are left out since what describes their channel is damaged, or never was there."""
    whole: bool = False
    """Whether there was nothing to repair."""


def repair(source: BinaryIO, target: BinaryIO) -> Repaired:
    """Write what can be read of an MCAP into `target`, in its order, whoever wrote it.

    Raises:
        MissingExtra: mcap, or what decompresses the file, is not installed.
        OSError: one cannot be read, or the other written.
    """
    records, copy = McapRecords(source), _Copy(target)
    found = copy.found
    for of, each in records_of_summary(source):
        copy.note(of, bytes(each))
    try:
        for kind, record in records.chunks():
            if kind != mcap_records.CHUNK:
                copy.put(kind, record)
                continue
            try:
                inner = records.broken_up(record)
            except BadRecording:
                found.damaged += 1
                continue
            for of, each in inner:
                copy.put(of, bytes(each))
    except BadRecording:
        pass  # nobody can tell where the next record begins
    copy.finish()
    found.whole = records.whole and not found.damaged and not found.undescribed
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
        self._noted: dict[tuple[int, int], Any] = {}
        """What describes channels once more, by kind and number."""
        self._numbers: dict[int, int] = {}
        self._begun = False

    def note(self, kind: int, record: bytes) -> None:
        """Remember what a summary says of a channel: where it is described first may be damaged."""
        if kind in (mcap_records.SCHEMA, mcap_records.CHANNEL):
            with suppress(Exception):  # whatever mcap makes of bytes that are no such record
                made = self._mcap.RECORDS[kind](record)
                self._noted[kind, made.id] = made

    def put(self, kind: int, record: bytes) -> None:
        """Copy a record, if that is what it claims to be."""
        read = self._mcap.RECORDS.get(kind)
        if read is None:
            return
        try:
            made = read(record)
        except Exception:  # noqa: BLE001 (whatever mcap makes of bytes that are no such record)
            self.found.damaged += 1
            return
        self._begin(made if kind == mcap_records.HEADER else None)
        match kind:
            case mcap_records.SCHEMA:
                self._put_schema(made)
            case mcap_records.CHANNEL:
                self._channels.setdefault(made.id, made)
            case mcap_records.MESSAGE:
                self._put_message(made)
            case mcap_records.ATTACHMENT:
                self._writer.add_attachment(
                    made.create_time, made.log_time, made.name, made.media_type, made.data
                )
            case mcap_records.METADATA:
                self._writer.add_metadata(made.name, made.metadata)

    def finish(self) -> None:
        self._begin(None)
        self._writer.finish()

    def _begin(self, header: Any) -> None:  # noqa: ANN401 - a record of mcap
        """Write the header, once: the one there is, if it comes first as it must."""
        if not self._begun:
            self._begun = True
            profile, library = ("", "") if header is None else (header.profile, header.library)
            self._writer.start(profile=profile, library=library)

    def _put_schema(self, schema: Any) -> None:  # noqa: ANN401 - a record of mcap
        if schema is not None and schema.id not in self._schemas:
            self._schemas[schema.id] = self._writer.register_schema(schema.name, schema.encoding, schema.data)
            self._names[schema.id] = schema.name

    def _channel(self, number: int) -> Any:  # noqa: ANN401 - a record of mcap
        """What describes a channel, with its schema in the copy; None if that cannot be read anywhere."""
        channel = self._channels.get(number) or self._noted.get((mcap_records.CHANNEL, number))
        if channel is None:
            return None
        self._put_schema(self._noted.get((mcap_records.SCHEMA, channel.schema_id)))
        return channel if channel.schema_id in self._schemas else None

    def _put_message(self, message: Any) -> None:  # noqa: ANN401 - a record of mcap
        channel = self._channel(message.channel_id)
        if channel is None:
            self.found.undescribed += 1
            return
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
