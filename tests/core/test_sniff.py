"""Files that are given as logs and are none: what is said of them, and what to do."""

import gzip
import io
import json
import sqlite3
import tarfile
import zipfile

import numpy as np
import pytest

from log_lines import POSE, SCAN, flaser, line, odom, robotlaser
from ogm_core.errors import BadRecording
from ogm_core.files.map_files import encode_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.logs.recordings import RecordingReader
from ogm_core.types import IDENTITY, Scan

CARMEN = b"# CARMEN Logfile\n\n" + odom() + b"\n" + flaser([1] * 180) + b"\n"
JSON_LINES = line(POSE) + b"\n" + line(SCAN) + b"\n"
CONVERT = "convert it to JSON lines (see docs/logs.md)"
UNPACK = "unpack it, bags are read as they are (see docs/logs.md)"
READ = (
    "JSON lines (.jsonl, .jsonl.gz), CARMEN (.log, .log.gz, .clf, .clf.gz) "
    "and g2o with laser lines (.g2o, .g2o.gz), and bags (folders, .db3, .mcap, .bag)"
)


def zipped(content):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("intel.clf", content)
    return file.getvalue()


def tarred(content):
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        entry = tarfile.TarInfo("intel.log")
        entry.size = len(content)
        archive.addfile(entry, io.BytesIO(content))
    return file.getvalue()


def database(tmp_path):
    path = tmp_path / "made.sqlite"
    with sqlite3.connect(path) as made:
        made.execute("CREATE TABLE messages (data BLOB)")
    made.close()
    return path.read_bytes()


@pytest.fixture
def complaint(tmp_path):
    """What is said of a file by name and content, after its path; it is one line."""

    def complaint(name, content):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(BadRecording) as refusal, RecordingReader(path) as reader:
            list(reader)
        said = str(refusal.value)
        assert said.startswith(f"{path}: ")
        assert "\n" not in said
        return said.removeprefix(f"{path}: ")

    return complaint


@pytest.mark.parametrize("name", ["map.bag", "map.log", "map.jsonl", "map"])
def test_bags_are_known_by_their_content(complaint, tmp_path, name):
    not_read = f"not a format that is read: {UNPACK}"
    assert complaint(name, b"#ROSBAG V2.0\n\0\x10") == f"a ROS 1 bag, {not_read}"
    assert complaint(name, b"\x89MCAP0\r\n\x01") == f"an MCAP file, as of a ROS 2 bag, {not_read}"
    sqlite = database(tmp_path)
    assert complaint(name, sqlite) == f"an SQLite database, as of a ROS 2 bag, {not_read}"
    packed = gzip.compress(b"#ROSBAG V2.0\n")
    assert complaint(f"{name}.gz", packed) == f"a ROS 1 bag, {not_read}"


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("map.bag", "a ROS 1 bag"),
        ("map.mcap", "an MCAP file"),
        ("map.db3", "an SQLite database"),
        ("map.rawlog", "an MRPT rawlog"),
        ("map.csv", "a table"),
        ("map.npy", "NumPy arrays"),
        ("map.csv.gz", "a table"),
        ("map.json", "a JSON document"),
        ("map.zip", "an archive"),
        ("map.tgz", "an archive"),
        ("map.tar.gz", "an archive"),
    ],
)
def test_other_formats_are_known_by_their_names(complaint, name, what):
    content = b"1.0, 2.0\n"
    said = complaint(name, gzip.compress(content) if name.endswith("gz") else content)
    assert said.startswith(what)
    assert ", not a format that is read: " in said
    assert "JSON lines" in said or "unpack it" in said


@pytest.mark.parametrize("name", ["map.txt", "map", "map.gz", "logjsonl", "map.png"])
def test_of_any_other_file_it_is_said_what_is_read(complaint, name):
    assert complaint(name, b"1.0 2.0\n") == f"not a format that is read; these are {READ}"


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (zipped(CARMEN), "a zip archive"),
        (tarred(CARMEN), "a tar archive"),
        (b"7z\xbc\xaf\x27\x1c\0\4", "a 7z archive"),
        (b"\xfd7zXZ\0\0\4", "packed with xz"),
        (b"BZh91AY&SY", "packed with bzip2"),
        (b"\x28\xb5\x2f\xfd\x24", "packed with zstd"),
    ],
)
@pytest.mark.parametrize("name", ["log.clf", "log.clf.gz", "log.zip", "log.txt"])
def test_archives_are_to_be_unpacked(complaint, name, content, what):
    said = complaint(name, content)
    assert said.startswith(f"{what}, not a format that is read: unpack it")
    assert complaint(f"{name}.tar.gz", gzip.compress(tarred(CARMEN))).startswith(
        "a tar archive, not a format"
    )


def test_folders(tmp_path):
    bag = tmp_path / "bag.log"
    bag.mkdir()
    for said in ("bag.log: a folder: give a log", "bag.log: the folder of a ROS 2 bag, not a format that is"):
        with pytest.raises(BadRecording, match=said):
            RecordingReader(bag).__enter__()
        (bag / "metadata.yaml").write_text("rosbag2_bagfile_information:\n")


@pytest.mark.parametrize("name", ["log.jsonl", "log.clf.gz", "log.txt", "log.bag"])
def test_an_empty_file(complaint, name):
    assert complaint(name, b"") == "empty, holds no scan"


def test_gzip_and_its_name_go_together(complaint):
    for name, content in {"log.jsonl": JSON_LINES, "log.clf": CARMEN}.items():
        said = complaint(name, gzip.compress(content))
        assert said == f"gzip by its content, but not by its name: rename it to {name}.gz"
        said = complaint(f"{name}.gz", content)
        assert said == f"not gzip, in spite of its name: rename it to {name}, or pack it with gzip"


@pytest.mark.parametrize(
    ("name", "content", "new"),
    [
        ("intel.txt", CARMEN, "intel.log"),
        ("intel.lab.log.old", robotlaser([1]), "intel.lab.log.log"),
        ("intel", CARMEN, "intel.log"),
        ("intel.TXT.GZ", gzip.compress(CARMEN), "intel.log.gz"),
        ("intel.json", JSON_LINES, "intel.jsonl"),
        ("intel.json.gz", gzip.compress(b"\n" + JSON_LINES), "intel.jsonl.gz"),
    ],
)
def test_a_log_by_another_name_is_to_be_renamed(complaint, name, content, new):
    said = complaint(name, content)
    assert said.endswith(f" by its content, but not by its name: rename it to {new}")
    assert said.startswith("a CARMEN log" if ".log" in new else "JSON lines")


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("name", ["log.jsonl", "log.clf", "log.txt"])
def test_utf_16(complaint, name, encoding):
    content = (JSON_LINES if name == "log.jsonl" else CARMEN).decode().encode(encoding)
    expected = "UTF-16 text: convert it to UTF-8 (iconv -f UTF-16 -t UTF-8)"
    assert complaint(name, content) == expected
    if name != "log.txt":
        assert complaint(f"{name}.gz", gzip.compress(content)) == expected


def test_one_json_array(complaint):
    """Its last element may stand on a line of its own: that one must not become the map."""
    expected = "one JSON array, not JSON lines: write one message a line (see docs/logs.md)"
    array = b" \n[\n" + line(SCAN) + b",\n" + line(SCAN) + b"\n]\n"
    assert complaint("log.jsonl", array) == expected
    assert complaint("log.jsonl.gz", gzip.compress(array)) == expected
    assert complaint("log.jsonl", json.dumps([SCAN]).encode()) == expected


def test_one_json_object_over_many_lines(complaint):
    said = complaint("log.jsonl", json.dumps({"scans": [SCAN]}, indent=1).encode())
    assert said.startswith("holds no scan; ")
    assert "lines are malformed, first line 1: not JSON" in said
    assert said.endswith("; it looks like one JSON document: write one message a line (see docs/logs.md)")


def test_text_of_one_format_under_the_name_of_another(complaint):
    said = complaint("log.jsonl.gz", gzip.compress(CARMEN))
    assert said.endswith("; it looks like a CARMEN log: rename it to log.log.gz")
    said = complaint("log.clf", JSON_LINES)
    assert said.startswith("holds no scan; 2 lines are malformed, first line 1: not a CARMEN message")
    assert said.endswith("; it looks like JSON lines: rename it to log.jsonl")


GRAPH = b"VERTEX2 0 1 2 0.5\nVERTEX2 1 2 2 0.5\nEDGE2 0 1 1 0 0 1 0 1 1 0 0\n"


@pytest.mark.parametrize("content", [GRAPH, b"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", b"FIX 0\n"])
@pytest.mark.parametrize("name", ["graph.g2o", "graph.log", "graph.G2O.GZ"])
def test_a_pose_graph_without_laser_lines_holds_no_scan(complaint, name, content):
    said = complaint(name, gzip.compress(content) if name.endswith("GZ") else content)
    assert said == (
        "holds no scan; it is a g2o pose graph without ROBOTLASER1 lines: give the log that it was made of"
    )


def test_a_pose_graph_by_another_name_is_to_be_renamed(complaint):
    said = complaint("graph.txt", GRAPH)
    assert said == "a g2o pose graph by its content, but not by its name: rename it to graph.g2o"
    assert complaint("graph.jsonl", GRAPH).endswith("it looks like a g2o pose graph: rename it to graph.g2o")


@pytest.mark.parametrize("first", ["FIX 0", "EDGE_SE2 0 1 1 0 0", "VERTEX2 0 0 0"])
@pytest.mark.parametrize("name", ["graph.g2o", "graph.log"])
def test_a_pose_graph_without_a_vertex_for_its_laser_lines(complaint, name, first):
    said = complaint(name, first.encode() + b"\n" + robotlaser([1, 2]) + b"\n")
    assert said.startswith("holds no scan; ")
    assert "malformed" in said


@pytest.mark.parametrize("name", ["map.gfs", "map.GFS.gz", "map.log", "map.txt"])
def test_the_output_of_gridfastslam(complaint, name):
    """It may begin with lines of a CARMEN log, which it is not."""
    content = odom() + b"\nLASER_READING 2 1.5 2.5 0 0 0 12.5\n"
    said = complaint(name, gzip.compress(content) if name.endswith("gz") else content)
    assert said == (
        "GridFastSLAM's output, not a format that is read: make a CARMEN log of it with GMapping's gfs2log"
    )


@pytest.mark.parametrize("name", ["map.npz", "map.log", "map.jsonl"])
def test_a_map_is_no_log(complaint, name):
    grid = OccupancyGrid(GridSettings())
    grid.integrate(Scan(0, 0.0, 0.1, 0.1, 8.0, np.full(9, 2.0, np.float32)), IDENTITY)
    said = complaint(name, encode_npz(grid.snapshot()))
    assert said == "that is a map, not a log: `ogm mapper --start-map` takes it"


def test_arrays_that_are_no_map(complaint):
    file = io.BytesIO()
    np.savez(file, ranges=np.ones(3))
    assert complaint("log.npz", file.getvalue()) == f"NumPy arrays, not a format that is read: {CONVERT}"


def test_a_carmen_log_of_other_messages_names_them(complaint):
    lines = [b"SYNC x", *[odom()] * 30, *[b"RLASER 1 2"] * 4, *[b"PARAM a b"] * 2]
    said = complaint("log.log", b"\n".join(lines))
    assert said == (
        "holds no scan; found are 30 ODOM, 4 RLASER, 2 PARAM, 1 SYNC; read are FLASER and ROBOTLASER1"
    )
    said = complaint("log.log", b"\n".join(b"NAME%d x" % k for k in range(40)))
    assert said.endswith("1 NAME6, 1 NAME7 and others; read are FLASER and ROBOTLASER1")
    said = complaint("log.log", b"ODOM 1\nwhat\n")
    assert said.startswith("holds no scan; 1 lines are malformed, first line 2: not a CARMEN message")
    assert said.endswith("; found are 1 ODOM; read are FLASER and ROBOTLASER1")


def test_binary_under_the_name_of_a_log(complaint):
    said = complaint("log.log", b"\x01\x02\0\0\xff\n" * 9)
    assert said.startswith("holds no scan; 9 lines are malformed")
    assert said.endswith("; it is binary, not text")


BROKEN_OFF = [b"\x1f\x8b", b"\x1f\x8b\x08\0garbage", gzip.compress(CARMEN, mtime=0)[:12]]


@pytest.mark.parametrize("content", BROKEN_OFF, ids=["two bytes", "garbage", "its first twelve bytes"])
def test_a_gzip_that_breaks_off_at_its_begin(complaint, content):
    said = complaint("log.log.gz", content)
    assert said.startswith(("not gzip, or corrupt", "truncated"))
