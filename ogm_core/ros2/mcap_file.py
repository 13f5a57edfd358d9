"""MCAP files: channels and messages, of whole files and of those that were cut short, as far as they go."""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from ogm_core.errors import BadRecording
from ogm_core.ros2 import mcap_records as records
from ogm_core.ros2.bag_channel import BagChannel
from ogm_core.ros2.mcap_records import DamagedRecord
from ogm_core.units import MEBIBYTE

_RUN = MEBIBYTE
"""Records outside of chunks are read in runs of about so many bytes."""


@dataclass(slots=True)
class _Block:
    """A chunk, or a run of records outside of chunks: where it lies, and what messages are in it."""

    begin: int
    end: int
    chunk: bool
    whole: bool = True
    start: int = -1
    channels: set[int] = field(default_factory=set)


class McapFile:
    """An MCAP file, which is read through once as it is opened: damage is told before any message is used.

    It is read as by a Reader of rosbags, whose names mean the same here. `cut_short` says how much was read
    of a file that has no end; it is "" for all others.
    """

    def __init__(self, path: Path) -> None:
        """Open it.

        Raises:
            BadRecording: it cannot be read, is damaged, or ends before its first message.
            MissingExtra: what decompresses it is not installed.
        """
        self.path = path
        self.start_time = self.end_time = self.message_count = 0
        self.cut_short = ""
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, records.Channel] = {}
        self._counts: Counter[int] = Counter()
        self._blocks: list[_Block] = []
        self._file: IO[bytes]
        try:
            self._file = path.open("rb")
            try:
                self._scan()
            except BaseException:
                self._file.close()
                raise
        except OSError as error:
            raise BadRecording(f"{path}: cannot be read ({error.strerror})") from error
        except DamagedRecord as error:
            raise BadRecording(
                f"{path}: a damaged MCAP: {error}; ogm record --repair saves what it can"
            ) from error

    @property
    def connections(self) -> tuple[BagChannel, ...]:
        """Its channels."""
        return tuple(
            BagChannel(
                each.id, each.topic, self._schemas.get(each.schema, ""), each.encoding, self._counts[each.id]
            )
            for each in self._channels.values()
        )

    def messages(self, channels: Collection[BagChannel]) -> Iterator[tuple[BagChannel, int, bytes]]:
        """The messages of some channels, by log time, which is the number; of equal ones in file order.

        Raises:
            BadRecording: the file has changed since it was opened.
        """
        wanted, number = {channel.id: channel for channel in channels}, 0
        waiting: list[tuple[int, int, records.Message]] = []

        def told() -> tuple[BagChannel, int, bytes]:
            message = heapq.heappop(waiting)[2]
            return wanted[message.channel], message.time, message.payload

        blocks = sorted(
            (block for block in self._blocks if not block.channels.isdisjoint(wanted)),
            key=lambda block: block.start,
        )
        for block in blocks:
            while waiting and waiting[0][0] < block.start:
                yield told()
            for message in self._messages_of(block):
                if message.channel in wanted:
                    heapq.heappush(waiting, (message.time, number, message))
                    number += 1
        while waiting:
            yield told()

    def close(self) -> None:
        """Read no more."""
        self._file.close()

    def _messages_of(self, block: _Block) -> Iterator[records.Message]:
        try:
            for kind, record in self._records_of(block):
                if kind == records.MESSAGE:
                    yield records.message(record)
        except (DamagedRecord, OSError) as error:
            raise BadRecording(f"{self.path}: changed while it was read: {error}") from error

    def _records_of(self, block: _Block) -> Iterator[tuple[int, memoryview]]:
        self._file.seek(block.begin)
        if block.chunk and block.end - block.begin > 2 * records.MAX_CHUNK:
            raise DamagedRecord(f"a chunk of {block.end - block.begin} bytes")
        data = self._file.read(block.end - block.begin)
        if block.chunk:
            data = records.chunk(data, whole=block.whole)
        return records.records_in(data, whole=block.whole)

    def _scan(self) -> None:
        size, magic = self.path.stat().st_size, len(records.MAGIC)
        self._file.seek(max(0, size - magic))
        has_end = self._file.read(magic) == records.MAGIC and size >= 2 * magic
        at, ended = magic, False
        while not ended and at + records.HEAD.size <= size:
            self._file.seek(at)
            kind, length = records.HEAD.unpack(self._file.read(records.HEAD.size))
            begin = at + records.HEAD.size
            if not kind or length > size - begin:  # a disk may fill up with zeros what it has lost
                if kind == records.CHUNK and not has_end:
                    self._scan_chunk(begin, size, whole=False)
                break
            at = begin + length
            ended = kind in (records.DATA_END, records.FOOTER)
            self._scan_record(kind, begin, at)
        if has_end and not ended:
            raise DamagedRecord(f"the record at byte {at} goes past its end")
        if not has_end:
            if not self.message_count:
                raise BadRecording(f"{self.path}: an MCAP that was cut short before its first message")
            read = f"{self.message_count} messages, {self._blocks[-1].end} of {size} bytes"
            self.cut_short = f"{self.path.name} was cut short, and is read as far as it goes: {read}"

    def _scan_record(self, kind: int, begin: int, end: int) -> None:
        if kind == records.CHUNK:
            self._scan_chunk(begin, end)
        elif kind == records.MESSAGE:
            self._file.seek(begin)
            head = self._file.read(min(records.MESSAGE_HEAD, end - begin))
            block = self._blocks[-1] if self._blocks else None
            if block is None or block.chunk or end - block.begin > _RUN:
                block = _Block(begin - records.HEAD.size, end, chunk=False)
                self._blocks.append(block)
            block.end = end
            self._note(block, records.message(memoryview(head)))
        elif kind in (records.SCHEMA, records.CHANNEL):
            self._file.seek(begin)
            self._define(kind, memoryview(self._file.read(end - begin)))

    def _scan_chunk(self, begin: int, end: int, *, whole: bool = True) -> None:
        block = _Block(begin, end, chunk=True, whole=whole)
        try:
            for kind, record in self._records_of(block):
                if kind == records.MESSAGE:
                    self._note(block, records.message(record[: records.MESSAGE_HEAD]))
                else:
                    self._define(kind, record)
        except DamagedRecord as error:
            if whole:
                raise DamagedRecord(f"{error}, at byte {begin}") from error
        if block.channels:
            self._blocks.append(block)

    def _define(self, kind: int, record: memoryview) -> None:
        if kind == records.SCHEMA:
            number, name = records.schema(record)
            self._schemas[number] = name
        elif kind == records.CHANNEL:
            channel = records.channel(record)
            if self._channels.setdefault(channel.id, channel) != channel:
                raise DamagedRecord(f"channel {channel.id} is described twice, in two ways")

    def _note(self, block: _Block, message: records.Message) -> None:
        if message.channel not in self._channels:
            raise DamagedRecord(f"a message is of channel {message.channel}, which is not described")
        if block.start < 0 or message.time < block.start:
            block.start = message.time
        self.start_time = min(self.start_time, message.time) if self.message_count else message.time
        self.end_time = max(self.end_time, message.time + 1)
        self.message_count += 1
        self._counts[message.channel] += 1
        block.channels.add(message.channel)
