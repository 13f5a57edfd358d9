"""What a gzip file holds is what Python's gzip finds in it, and is refused where that refuses."""

import gzip
import io
import struct
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.logs import unpacking
from ogm_core.logs.unpacking import GzipContent

TEXT = "".join(f"line {k} of {k * k % 7919}\n" for k in range(60)).encode()
PACKED = gzip.compress(TEXT, mtime=0)


def unpacked(data):
    return judged(lambda file: io.BufferedReader(GzipContent(file), 37), data)


def judged(opened, data):
    """What is read of a file, as (content, complaint)."""
    try:
        return b"".join(opened(io.BytesIO(data))), ""
    except EOFError:
        return b"", "truncated"
    except (gzip.BadGzipFile, zlib.error):
        return b"", "corrupt"


def by_python(data):
    return judged(lambda file: gzip.GzipFile(fileobj=file), data)


@pytest.fixture(autouse=True, params=[1, 50, 65536])
def chunk(request, monkeypatch):
    monkeypatch.setattr(unpacking, "_CHUNK", request.param)


@pytest.mark.parametrize("level", [0, 1, 9])
def test_it_is_read_whole(level):
    assert unpacked(gzip.compress(TEXT, level)) == (TEXT, "")


def test_members_follow_one_another_and_zeros_follow_them():
    assert unpacked(PACKED + PACKED) == (TEXT + TEXT, "")
    assert unpacked(PACKED + b"\0" * 9 + PACKED + b"\0") == (TEXT + TEXT, "")
    assert unpacked(gzip.compress(b"") + PACKED) == (TEXT, "")
    assert unpacked(b"") == (b"", "")


def test_a_long_run_of_one_byte_is_read_in_pieces():
    assert unpacked(gzip.compress(b"a" * 1_000_000)) == (b"a" * 1_000_000, "")


@pytest.mark.parametrize(
    "flags_and_more", [(8, b"name\0"), (16, b"said\0"), (4, b"\3\0abc"), (12, b"\1\0xn\0")]
)
def test_what_a_header_may_say_is_passed_over(flags_and_more):
    flags, more = flags_and_more
    assert unpacked(PACKED[:3] + bytes([flags]) + PACKED[4:10] + more + PACKED[10:]) == (TEXT, "")


def test_where_it_breaks_off_it_is_truncated():
    for length in range(2, len(PACKED)):
        assert unpacked(PACKED[:length]) == (b"", "truncated"), length
    assert unpacked(PACKED + PACKED[:5]) == (b"", "truncated")


@pytest.mark.parametrize(
    "damaged",
    [
        PACKED + b"tail",
        PACKED + b"\x1f",
        PACKED + b"\0x",
        b"no gzip at all",
        PACKED[:-8] + b"\0" * 8,
        PACKED[:-4] + struct.pack("<I", len(TEXT) + 1),
        PACKED[:2] + b"\x09" + PACKED[3:],
        PACKED[:20] + b"\xff" * 10 + PACKED[30:],
    ],
)
def test_what_is_damaged_or_none_is_corrupt(damaged):
    assert unpacked(damaged) == by_python(damaged) == (b"", "corrupt")


@given(st.lists(st.tuples(st.integers(10, len(PACKED) - 1), st.integers(0, 255)), min_size=1, max_size=3))
def test_a_flipped_byte_is_found_as_python_finds_it(changes):
    data = bytearray(PACKED)
    for at, value in changes:
        data[at] = value
    assert unpacked(bytes(data)) == by_python(bytes(data))
