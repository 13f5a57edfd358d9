"""A line of a log that is longer than any scan's is malformed, and never read as a whole."""

import gzip
import tracemalloc

import pytest

from log_lines import SCAN, flaser, line
from ogm_core.errors import BadRecording
from ogm_core.logs.recordings import RecordingReader

MEBIBYTE = 1024**2


def read_all(path, **options):
    """(messages, reader, most bytes that were allocated at once) of a file."""
    tracemalloc.start()
    try:
        with RecordingReader(path, **options) as reader:
            return list(reader), reader, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["log.jsonl", "log.log.gz"])
def test_a_line_of_a_gigabyte_is_passed_over(tmp_path, name):
    path, text = tmp_path / name, line(SCAN) if "jsonl" in name else flaser([1] * 180)
    if name.endswith(".gz"):  # a bomb: 1 GiB in 1 MB
        member = gzip.compress(b" " * 64 * MEBIBYTE)
        path.write_bytes(gzip.compress(text + b"\n") + member * 16 + gzip.compress(b"\n" + text + b"\n"))
    else:
        with path.open("wb") as file:  # a hole takes no place on the disk
            file.write(text + b"\n")
            file.seek(1024 * MEBIBYTE)
            file.write(b"\n" + text + b"\n")
    messages, reader, most = read_all(path)
    assert (len(messages), reader.malformed) == (2, 1)
    assert reader.complaints == [
        "line 2: it is longer than any line of a scan can be: 24 bytes a beam, up to max_beams"
    ]
    assert most < 12 * MEBIBYTE  # 24 x 200,000 bytes and what reading takes


@pytest.mark.parametrize("ending", [b"\n", b"\r\n", b""])
def test_the_limit_is_exact_and_moves_with_max_beams(tmp_path, ending):
    text = line(SCAN)
    longest = 24 * 100 + 4096
    fits = text + b" " * (longest - len(text) - len(ending)) + ending
    path = tmp_path / "log.jsonl"
    path.write_bytes(text + b"\n" + fits)
    messages, reader, _ = read_all(path, max_beams=100)
    assert (len(messages), reader.malformed) == (2, 0)
    path.write_bytes(text + b"\n" + b" " + fits)
    messages, reader, _ = read_all(path, max_beams=100)
    assert (len(messages), reader.malformed) == (1, 1)
    assert (len(read_all(path, max_beams=101)[0]), reader.malformed) == (2, 1)


def test_a_log_that_is_one_endless_line_holds_no_scan(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(b"\xef\xbb\xbf{" + b" " * 6 * MEBIBYTE)
    with pytest.raises(
        BadRecording, match=r"holds no scan; 1 lines are malformed, first line 1: it is longer"
    ):
        read_all(path)
