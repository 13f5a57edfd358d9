"""Recorded logs as files, in and out."""

import gzip
import math
import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from log_lines import POSE, SCAN, flaser, line, robotlaser, same
from ogm_core.errors import BadRecording, BadSetting
from ogm_core.logs.recordings import (
    CARMEN_SUFFIXES,
    JSON_SUFFIXES,
    RecordedPose,
    RecordedScan,
    RecordingReader,
    write_jsonl,
)
from ogm_core.types import Pose, PoseStamped, Scan

DATASETS = os.environ.get("OGM_DATASETS")


def read_all(path, **options):
    """(messages, reader) of a file."""
    with RecordingReader(path, **options) as reader:
        return list(reader), reader


@pytest.fixture
def saved(tmp_path):
    """Saves lines under a name, gzipped if it says so."""

    def save(name, *lines):
        path = tmp_path / name
        data = b"".join(text + b"\n" for text in lines)
        path.write_bytes(gzip.compress(data) if name.lower().endswith(".gz") else data)
        return path

    return save


@pytest.mark.parametrize("suffix", [*JSON_SUFFIXES, ".JSONL.GZ"])
def test_json_files_are_read_by_suffix(saved, suffix):
    messages, reader = read_all(saved(f"log{suffix}", line(POSE), line(SCAN), b"bad", line(POSE)))
    assert [type(message) for message in messages] == [RecordedPose, RecordedScan, RecordedPose]
    assert (reader.scans, reader.poses, reader.malformed) == (1, 2, 1)
    assert reader.complaints == ["line 3: not JSON (Expecting value, column 1)"]


@pytest.mark.parametrize("suffix", CARMEN_SUFFIXES)
def test_carmen_files_are_read_by_suffix(saved, suffix):
    messages, reader = read_all(saved(f"log{suffix}", b"# a", b"ODOM 1", flaser([1] * 180), flaser([1] * 90)))
    assert len(messages) == 1
    assert (reader.scans, reader.poses, reader.malformed) == (1, 0, 1)


def test_the_order_of_the_file_is_kept(saved):
    stamps = [50, 10, 10, 0, 90, 20]
    lines = [line(SCAN, stamp=stamp) if stamp % 20 else line(POSE, stamp=stamp) for stamp in stamps]
    messages, _ = read_all(saved("log.jsonl", *lines))
    assert [message.message.stamp for message in messages] == stamps


def test_a_last_line_without_an_end_is_read(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(line(POSE) + b"\r\n" + line(SCAN))
    assert len(read_all(path)[0]) == 2


def test_only_the_first_complaints_are_kept_and_they_are_short(saved):
    _, reader = read_all(saved("log.jsonl", line(SCAN), *[line(POSE, robot="/" * 9000)] * 8))
    assert reader.malformed == 8
    assert [text.split(":")[0] for text in reader.complaints] == [f"line {k}" for k in range(2, 7)]
    assert max(map(len, reader.complaints)) < 250


@pytest.mark.parametrize("name", ["log.jsonl", "log.jsonl.gz"])
def test_position_runs_from_nothing_to_the_size(saved, name):
    rng = np.random.default_rng(0)
    lines = [line(SCAN, ranges=rng.random(500).tolist()) for _ in range(200)]
    path = saved(name, *lines)
    with RecordingReader(path) as reader:
        assert (reader.position, reader.size) == (0, path.stat().st_size)
        positions = [reader.position for _ in reader]
        assert reader.position == reader.size
    assert reader.position == reader.size
    assert positions == sorted(positions)
    assert 0 < positions[0] < reader.size / 10
    assert reader.size * 0.4 < positions[100] < reader.size * 0.6


def test_range_max_replaces_that_of_every_scan(saved):
    path = saved("log.jsonl", line(SCAN), line(SCAN, range_min=7.0, range_max=50), line(SCAN, range_min=6.5))
    messages, reader = read_all(path, range_max=7.0)
    assert [message.message.range_max for message in messages] == [7.0, 7.0]
    assert reader.complaints == ["line 2: range_min: 0 <= range_min < range_max is needed, got 7 and 7"]
    [scan], _ = read_all(saved("log.log", flaser([1] * 180)), range_max=81.0)
    assert scan.message.range_max == 81.0


@pytest.mark.parametrize("range_max", [0.0, -1.0, math.nan, math.inf, 1000.1])
def test_a_range_max_that_is_none_is_refused(tmp_path, range_max):
    with pytest.raises(BadSetting, match=r"^range-max: "):
        RecordingReader(tmp_path / "log.jsonl", range_max=range_max)


@pytest.mark.parametrize("name", ["log.jsonl", "log.jsonl.gz", "log.log", "log.g2o"])
def test_a_mark_before_the_text_is_no_part_of_it(tmp_path, name):
    """Windows programs write one, and tell UTF-8 by it."""
    texts = {
        "log.log": flaser([1] * 180),
        "log.g2o": b"VERTEX2 0 0 0 0\n" + robotlaser([1]),
    }
    content = b"\xef\xbb\xbf" + texts.get(name, line(SCAN)) + b"\n"
    path = tmp_path / name
    path.write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    messages, reader = read_all(path)
    assert (len(messages), reader.malformed) == (1, 0)


def test_a_mark_does_not_hide_what_a_file_is(tmp_path):
    path = tmp_path / "log.jsonl"
    path.write_bytes(b"\xef\xbb\xbf[" + line(SCAN) + b"]")
    with pytest.raises(BadRecording, match="one JSON array, not JSON lines"):
        read_all(path)


@pytest.mark.parametrize("name", ["log.jsonl", "log.log", "log.g2o"])
def test_ranges_at_and_above_a_given_maximum_are_no_returns(saved, name):
    """Compared as the float32 that ranges are, of which 5.7 is below the number 5.7."""
    assert float(np.float32(5.7)) < 5.7
    ranges = ["5.69", "5.7", "5.8", "80", "nan"]
    lines = {
        "log.jsonl": [line(SCAN, ranges=[5.69, 5.7, 5.8, 80, "nan"])],
        "log.log": [robotlaser(ranges)],
        "log.g2o": [b"VERTEX2 0 0 0 0", robotlaser(ranges)],
    }
    [scan], _ = read_all(saved(name, *lines[name]), range_max=5.7)
    assert scan.message.range_max == 5.7
    expected = np.array([5.69, np.inf, np.inf, np.inf, np.nan], np.float32)
    np.testing.assert_array_equal(scan.message.ranges, expected)


def test_the_ranges_of_json_lines_stay_what_they_are_without_one(saved):
    [scan], _ = read_all(saved("log.jsonl", line(SCAN, ranges=[29, 30, 31])))
    np.testing.assert_array_equal(scan.message.ranges, np.float32([29, 30, 31]))


@pytest.mark.parametrize("name", ["log.jsonl", "log.log"])
def test_max_beams_holds_for_every_format(saved, name):
    long, short = (
        (line(SCAN), line(SCAN, ranges=[1]))
        if name == "log.jsonl"
        else (robotlaser([1] * 5), robotlaser([1]))
    )
    messages, reader = read_all(saved(name, long, short), max_beams=4)
    assert (len(messages), reader.malformed) == (1, 1)
    assert "ranges: 1 to 4 beams are needed, got 5" in reader.complaints[0]


def test_robot_renames_the_one_robot(saved):
    messages, _ = read_all(saved("log.jsonl", line(POSE), line(SCAN)), robot="other")
    assert [message.robot for message in messages] == ["other", "other"]
    assert messages[0].message == PoseStamped(10, Pose(1.0, 2.0, 0.5), 1, "a")
    assert messages[1].sensor == "front"
    [scan], _ = read_all(saved("log.log", flaser([1] * 180)), robot="other")
    assert (scan.robot, scan.sensor) == ("other", "laser")


def test_robot_refuses_a_log_of_two_robots(saved):
    path = saved("log.jsonl", line(SCAN), line(POSE, robot="r2"))
    assert [message.robot for message in read_all(path)[0]] == ["r1", "r2"]
    with pytest.raises(BadRecording, match=r"holds robots r1 and r2; --robot renames one"):
        read_all(path, robot="r1")
    with pytest.raises(BadSetting, match=r"^robot 'a/b'"):
        RecordingReader(path, robot="a/b")


@pytest.mark.parametrize(
    ("name", "lines", "text"),
    [
        ("log.jsonl", [b""], "holds no scan$"),
        ("log.jsonl.gz", [], "holds no scan$"),
        ("log.jsonl", [line(POSE), line(POSE)], "holds no scan, only 2 poses$"),
        ("log.log", [b"# nothing"], "holds no scan$"),
        ("log.log", [line(SCAN)], "holds no scan; 1 lines are malformed, first line 1: not a CARMEN"),
    ],
)
def test_a_log_without_a_scan_is_refused(saved, name, lines, text):
    with pytest.raises(BadRecording, match=f"log.*: {text}"):
        read_all(saved(name, *lines))


@pytest.mark.parametrize("share", [0.02, 0.5, 0.9, 0.999])
def test_a_truncated_gzip_is_refused(saved, share):
    path = saved("log.jsonl.gz", *[line(SCAN, seq=k * 7919) for k in range(2000)])
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(BadRecording, match=r"log\.jsonl\.gz: truncated"):
        read_all(path)


def test_a_corrupt_gzip_is_refused(saved):
    path = saved("log.log.gz", flaser([1] * 180))
    data = path.read_bytes()
    for damaged in (data[:20] + b"\xff" * 10 + data[30:], data[:-8] + b"\0" * 8, data + b"tail"):
        path.write_bytes(damaged)
        with pytest.raises(BadRecording, match=r"log\.log\.gz: not gzip, or corrupt"):
            read_all(path)


def test_a_file_that_cannot_be_opened_is_refused(tmp_path, monkeypatch):
    with pytest.raises(BadRecording, match=r"none\.jsonl: cannot be read \(No such file"):
        read_all(tmp_path / "none.jsonl")

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(BadRecording, match=r"log\.jsonl: cannot be read \(Permission denied"):
        read_all(tmp_path / "log.jsonl")


def test_a_reader_is_read_inside_its_with(saved):
    reader = RecordingReader(saved("log.jsonl", line(SCAN)))
    with pytest.raises(ValueError, match="inside its `with`"):
        next(iter(reader))


def test_the_caller_s_own_errors_stay_its_own(saved):
    path = saved("log.jsonl.gz", line(SCAN))

    def consume():
        with RecordingReader(path) as reader:
            for _ in reader:
                raise EOFError("mine")

    with pytest.raises(EOFError, match="mine"):
        consume()


def recording():
    ranges = np.array([0.1, np.nan, np.inf], np.float32)
    return [
        RecordedPose("r1", PoseStamped(9, Pose(0.1, 0.2, 1e-17), 3, "run")),
        RecordedScan(
            "r1", "front", Scan(5, -1.0, 0.1, 0.0, 8.0, ranges, 1e-4, Pose(1.0, 2.0, 3.0), None, 4, "run")
        ),
        RecordedScan("r2", "rear", Scan(7, -1.0, 0.1, 0.0, 8.0, ranges, pose=Pose(0.3, 0.2, 0.1))),
    ]


@pytest.mark.parametrize("suffix", JSON_SUFFIXES)
def test_a_written_file_reads_back_and_is_reproducible(tmp_path, suffix):
    one, two = tmp_path / f"one{suffix}", tmp_path / f"two{suffix}"
    write_jsonl(one, recording())
    write_jsonl(two, iter(recording()))
    assert one.read_bytes() == two.read_bytes()
    messages, reader = read_all(one)
    assert reader.malformed == 0
    assert len(messages) == 3
    assert all(map(same, recording(), messages))
    assert sorted(path.name for path in tmp_path.iterdir()) == [one.name, two.name]


def test_a_gzipped_file_carries_no_time(tmp_path):
    path = tmp_path / "log.jsonl.gz"
    write_jsonl(path, recording())
    header = path.read_bytes()[:10]
    assert header[3] == 0  # no file name
    assert header[4:8] == b"\0\0\0\0"


@pytest.mark.parametrize("suffix", JSON_SUFFIXES)
def test_a_failure_leaves_what_was_there_before(tmp_path, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(b"before")

    def failing():
        yield from recording()
        raise RuntimeError("midway")

    with pytest.raises(RuntimeError, match="midway"):
        write_jsonl(path, failing())
    assert path.read_bytes() == b"before"
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    for name in ("log.log", "log", "log.json", "log.gz"):
        with pytest.raises(BadRecording, match=rf"{name}: recordings are written as \.jsonl or \.jsonl\.gz"):
            write_jsonl(tmp_path / name, recording())
    with pytest.raises(BadRecording, match=r"log\.jsonl: cannot be written \(No such file"):
        write_jsonl(tmp_path / "none" / "log.jsonl", recording())
    folder = tmp_path / "folder.jsonl"
    folder.mkdir()
    with pytest.raises(BadRecording, match=r"folder\.jsonl: cannot be written \(it is a folder\)"):
        write_jsonl(folder, recording())
    assert list(tmp_path.iterdir()) == [folder]


@pytest.mark.skipif(DATASETS is None, reason="OGM_DATASETS does not name the folder of recorded logs")
@pytest.mark.parametrize(
    ("name", "scans", "beams", "shortest", "longest"),
    [
        ("intel/intel-corrected.log.gz", 910, 180, 0.23, 25.38),
        ("freiburg-079/freiburg-079-corrected.log.gz", 4791, 360, 0.12, 36.62),
    ],
)
def test_recorded_buildings_are_read_whole(name, scans, beams, shortest, longest):
    messages, reader = read_all(Path(DATASETS) / name)
    assert (reader.scans, reader.poses, reader.malformed) == (scans, 0, 0)
    ranges = np.array([message.message.ranges for message in messages])
    assert ranges.shape == (scans, beams)
    assert (ranges.min(), ranges[np.isfinite(ranges)].max()) == (np.float32(shortest), np.float32(longest))
    assert np.isinf(ranges).any(), "what says 81.83 or 81.91 is no return"
    assert all(message.message.pose is not None for message in messages)


@pytest.mark.skipif(DATASETS is None, reason="OGM_DATASETS does not name the folder of recorded logs")
def test_a_recorded_building_survives_conversion(tmp_path):
    messages, _ = read_all(Path(DATASETS) / "intel/intel-corrected.log.gz")
    first = messages[0].message
    assert first.pose == Pose(0.600266, -0.0320327, -0.354665)
    assert first.stamp == 32_906_800_000
    stamps = [message.message.stamp for message in messages]
    assert sum(later < earlier for earlier, later in pairwise(stamps)) == 4
    write_jsonl(tmp_path / "intel.jsonl.gz", messages)
    assert all(map(same, messages, read_all(tmp_path / "intel.jsonl.gz")[0]))
