"""MCAP files are read whatever their chunks, as far as they go if they were cut."""

import contextlib

import pytest

import mcap_bytes as mcap
from ogm_core.errors import BadRecording
from ogm_core.ros2.mcap_file import McapFile
from ogm_core.ros2.mcap_records import MAX_CHUNK

NAMES = mcap.schema(1, "a/msg/A") + mcap.channel(3, 1, "/a") + mcap.channel(4, 0, "/j", "json")


def said(of_channel, *times):
    return b"".join(mcap.message(of_channel, time, f"{of_channel}@{time}".encode()) for time in times)


def opened(path, data):
    path.write_bytes(data)
    return contextlib.closing(McapFile(path))


def told(file, topic="/a"):
    wanted = [each for each in file.connections if each.topic == topic]
    return [(time, payload) for _, time, payload in file.messages(wanted)]


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_channels_and_messages(tmp_path, compression):
    data = mcap.whole(mcap.chunk(NAMES + said(3, 7, 9) + said(4, 8), compression))
    with opened(tmp_path / "a.mcap", data) as file:
        assert [tuple(each) for each in file.connections] == [
            (3, "/a", "a/msg/A", "cdr", 2),
            (4, "/j", "", "json", 1),
        ]
        assert told(file) == [(7, b"3@7"), (9, b"3@9")]
        assert told(file, "/j") == [(8, b"4@8")]
        assert (file.start_time, file.end_time, file.message_count, file.cut_short) == (7, 10, 3, "")


def test_messages_come_by_log_time_from_whichever_chunk(tmp_path):
    """Of equal times the earlier in the file comes first; messages may lie outside of chunks."""
    parts = [mcap.chunk(NAMES + said(3, 5, 1)), said(3, 4), mcap.chunk(said(3, 2, 9), "zstd"), said(3, 9)]
    with opened(tmp_path / "a.mcap", mcap.whole(*parts)) as file:
        assert [time for time, _ in told(file)] == [1, 2, 4, 5, 9, 9]
        both = file.messages(file.connections)
        assert [time for _, time, _ in both] == [1, 2, 4, 5, 9, 9]


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_a_file_that_was_cut_is_read_as_far_as_it_goes(tmp_path, compression):
    """Cut anywhere: a chunk that is not compressed gives even those of its messages that are there."""
    parts = [mcap.chunk(part, compression) for part in (NAMES + said(3, 1, 2), said(3, 3, 4), said(3, 5, 6))]
    data = mcap.whole(*parts)
    ends = [len(mcap.MAGIC + mcap.header()) + sum(map(len, parts[:n])) for n in range(4)]
    for cut in range(ends[1], len(data), 3):
        with opened(tmp_path / "a.mcap", data[:cut]) as file:
            times = [time for time, _ in told(file)]
            chunks = sum(end <= cut for end in ends[1:])
            assert times == list(range(1, len(times) + 1))
            assert 2 * chunks <= len(times) <= 2 * chunks + (2 if chunks < 3 else 0)
            assert (
                f"a.mcap was cut short, and is read as far as it goes: {len(times)} messages"
                in file.cut_short
            )
            assert f"of {cut} bytes" in file.cut_short
    tail = mcap.message(3, 6, b"3@6")
    with opened(tmp_path / "b.mcap", data[: ends[3] - len(tail)]) as file:
        assert [time for time, _ in told(file)] == ([1, 2, 3, 4] if compression else [1, 2, 3, 4, 5])


def test_a_file_that_ends_in_zeros_was_cut(tmp_path):
    """As a disk leaves it that lost its power."""
    data = mcap.MAGIC + mcap.header() + mcap.chunk(NAMES + said(3, 1)) + said(3, 2)
    with opened(tmp_path / "a.mcap", data + bytes(5000)) as file:
        assert [time for time, _ in told(file)] == [1, 2]
        assert f"2 messages, {len(data)} of {len(data) + 5000} bytes" in file.cut_short


def test_of_nothing_nothing_can_be_read(tmp_path):
    data = mcap.MAGIC + mcap.header() + NAMES
    for cut in (8, 9, 20, len(data)):
        with pytest.raises(BadRecording, match="cut short before its first message"):
            opened(tmp_path / "a.mcap", data[:cut])


def flipped(data, at):
    return data[:at] + bytes([data[at] ^ 0x40]) + data[at + 1 :]


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_a_flipped_byte_in_a_chunk_is_damage(tmp_path, compression):
    """Of a whole file and of one that was cut later; it is told before any message is used."""
    first = mcap.chunk(NAMES + said(3, *range(50)), compression)
    data = mcap.whole(first, said(3, 60))
    begin = len(mcap.MAGIC + mcap.header())
    for at in range(begin + len(first) - 60, begin + len(first) - 8):  # lz4 ends in what nobody needs
        for damaged in (flipped(data, at), flipped(data[:-20], at)):
            with pytest.raises(BadRecording, match="damaged MCAP: a chunk"):
                opened(tmp_path / "a.mcap", damaged)


@pytest.mark.parametrize(
    ("part", "why"),
    [
        (
            mcap.chunk(NAMES, size=MAX_CHUNK + 1),
            f"a chunk of {MAX_CHUNK + 1} bytes: no more than {MAX_CHUNK}",
        ),
        (mcap.chunk(NAMES, size=2**63), "no more than"),
        (mcap.chunk(bytes(10**7), "zstd", size=1000), "does not decompress to the length that it gives"),
        (mcap.chunk(bytes(10**7), "lz4", size=1000), "does not decompress to the length that it gives"),
        (mcap.chunk(NAMES, "br\notli"), r"compressed by 'br\?otli', which is none of lz4 and zstd"),
        (mcap.chunk(NAMES[:-3]), "a record ends past its chunk"),
        (mcap.record(0x06, b"short"), "a record is too short for its kind"),
        (mcap.channel(3, 1, "/other") + NAMES, "channel 3 is described twice, in two ways"),
        (said(9, 1), "a message is of channel 9, which is not described"),
        (mcap.record(0x05, b"short"), "a record is too short for its kind"),
        (mcap.record(0x04, b"\1\0\1\0\xff\xff\xff\xff"), "a text ends past its record"),
        (mcap.record(0x03, b"\1\0\1\0\0\0\xff"), "a text is not UTF-8"),
        (b"\x05" + bytes([0xFF] * 8), "goes past its end"),
        (bytes(9), "goes past its end"),
    ],
)
def test_what_cannot_be_is_told_in_a_line(tmp_path, part, why):
    with pytest.raises(BadRecording, match=why) as refused:
        opened(tmp_path / "a.mcap", mcap.whole(part, NAMES))
    assert "a damaged MCAP" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_channels_may_be_described_again(tmp_path):
    """As writers do in each chunk, and in the summary."""
    with opened(tmp_path / "a.mcap", mcap.whole(NAMES, said(3, 1), mcap.chunk(NAMES + said(3, 2)))) as file:
        assert [time for time, _ in told(file)] == [1, 2]


def test_what_is_of_no_use_is_passed_over(tmp_path):
    """Attachments and kinds of records that are to come."""
    extra = mcap.record(0x09, bytes(100)) + mcap.record(0x42, b"later")
    with opened(tmp_path / "a.mcap", mcap.whole(extra, NAMES, said(3, 1), extra, said(3, 2))) as file:
        assert [time for time, _ in told(file)] == [1, 2]


def test_a_file_that_changes_while_it_is_read_is_told_of(tmp_path):
    data = mcap.whole(mcap.chunk(NAMES + said(3, *range(500))))
    with opened(tmp_path / "a.mcap", data) as file:
        (tmp_path / "a.mcap").write_bytes(flipped(data, len(data) // 2))
        with pytest.raises(BadRecording, match="changed while it was read"):
            told(file)
