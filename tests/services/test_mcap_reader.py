"""MCAP recordings as logs: the same messages as in JSON lines, and the same map; what is wrong is told."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest

import naive_cdr
from full_disk import room_for
from ogm_core.errors import BadRecording, DiskFull
from ogm_core.logs.recorded import RecordedPose, RecordedScan
from ogm_core.logs.recordings import RecordingReader, to_line, write_jsonl
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.commands.build import run_build
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.info import run_info
from ogm_services.commands.log_readers import ReadAs, log_reader
from ogm_services.commands.simulator import record
from ogm_services.commands.simulator_options import SimulatorOptions
from ogm_services.ros2.bag_reader import BagOptions
from ogm_services.ros2.mcap_file import write_mcap
from ogm_services.ros2.mcap_reader import McapReader
from ogm_services.settings.settings import Settings

OPTIONS = SimulatorOptions("lab", 2, 20.0, 1, None, None, None, None, 30)


def scan(stamp, *ranges, **fields):
    ranges = np.array(ranges or (1.0, 7.0, 8.5), np.float32)
    return Scan(stamp, 0.1, 0.3, 0.0, 8.0, ranges, **fields)


def read(path, **options):
    with McapReader(path, **options) as reader:
        return reader, list(reader)


def test_a_simulated_recording_is_that_of_json_lines(tmp_path):
    """The stamps go round from robot to robot, and the order is kept."""
    for name in ("a.mcap", "b.mcap", "a.jsonl"):
        record(OPTIONS, tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    with RecordingReader(tmp_path / "a.jsonl") as lines:
        expected = list(map(to_line, lines))
    reader, found = read(tmp_path / "a.mcap")
    assert list(map(to_line, found)) == expected
    assert (reader.scans, reader.poses, reader.malformed, reader.doubt) == (60, 60, 0, "")
    assert reader.position > 0.9 * reader.size


@pytest.mark.parametrize("flags", [{}, {"range_max": 5.0}])
def test_its_map_is_that_of_json_lines(tmp_path, flags):
    """Poses and mounts, scans that carry their poses, stamps that go back, runs that change."""
    said = []
    for n in range(40):
        run, stamp = ("a", "b")[n >= 20], (n % 20) * 100_000_000
        said.append(RecordedPose("r", PoseStamped(stamp, Pose(0.01 * n, 0.1 * n, 0.3), n % 20, run)))
        mounted = scan(stamp, seq=n % 20, run=run, mount=Pose(0.2, 0.1, 0.7), time_increment=1e-4)
        said.append(RecordedScan("r", "front", mounted))
        said.append(RecordedScan("r", "top", scan(stamp, pose=Pose(1e-9, n / 3, 2.0), seq=n, run="t")))
    write_mcap(tmp_path / "a.mcap", said)
    write_jsonl(tmp_path / "a.jsonl", said)
    for kind in ("mcap", "jsonl"):
        log, out = tmp_path / f"a.{kind}", tmp_path / kind
        run_build(BuildRequest([log], out, Settings(), read_as=ReadAs(**flags), held=HeldScans(3)))
    maps = [dict(np.load(tmp_path / kind / "map.npz")) for kind in ("mcap", "jsonl")]
    assert np.isfinite(maps[0]["log_odds"]).sum() > 100
    for name in maps[0]:
        np.testing.assert_array_equal(maps[0][name], maps[1][name], strict=True)
    quality = [json.loads((tmp_path / kind / "quality.json").read_text()) for kind in ("mcap", "jsonl")]
    assert quality[0] == quality[1]


def test_a_robot_is_renamed_and_a_longest_range_given(tmp_path):
    path = tmp_path / "a.mcap"
    write_mcap(path, [RecordedScan("r", "s", scan(1, 1.0, 4.0, 4.5))])
    _, (found,) = read(path, robot="bee", range_max=4.0)
    assert (found.robot, found.message.range_max) == ("bee", 4.0)
    assert found.message.ranges.tolist() == [1.0, np.inf, np.inf]
    write_mcap(path, [RecordedScan(name, "s", scan(1)) for name in ("r", "q")])
    with pytest.raises(BadRecording, match="holds robots r and q"):
        read(path, robot="bee")


def test_what_is_malformed_is_counted_and_passed_over(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.pose("r", PoseStamped(1, Pose(0.0, 0.0, 0.0)), 1)
        writer._put("ogm_msgs/msg/Pose", "r", "", b"no pose", 2, 2)
        writer._put("ogm_msgs/msg/Pose", "r", "", naive_cdr.ogm_pose(-5, 0, "", (0, 0, 0)), 3, 3)
        writer._put("ogm_msgs/msg/Pose", "no name", "", naive_cdr.ogm_pose(5, 0, "", (0, 0, 0)), 3, 3)
        writer.scan("r", "s", scan(4), 4)
        writer.finish()
    reader, found = read(path)
    assert [type(each) for each in found] == [RecordedPose, RecordedScan]
    assert reader.malformed == 3
    assert reader.complaints[0].startswith("/ogm/robots/r/pose: payload: 7 bytes are not a ogm_msgs/msg/Pose")
    assert reader.complaints[1] == "/ogm/robots/r/pose: stamp: 0 to 2^63 - 1 is needed, got -5"
    assert "robot 'no name'" in reader.complaints[2]


def test_of_a_chunk_that_was_cut_what_can_be_read_is_read_and_told(tmp_path):
    """All is in one chunk, as `ogm simulate` writes it: no byte of it is whole, and yet there are scans."""
    path = tmp_path / "cut.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        for n in range(300):
            ranges = np.random.default_rng(n).uniform(1.0, 5.0, 200).astype(np.float32)
            writer.scan("r", "s", replace(scan(n, seq=n, run="a"), ranges=ranges), n)
        writer.finish()
    os.truncate(path, path.stat().st_size // 2)
    reader, found = read(path)
    assert 0 < len(found) < 300
    size = path.stat().st_size
    told = (
        f"{reader.position} of {size} bytes are whole, of the others is read what can be, {len(found)} scans"
    )
    assert told in reader.doubt
    assert reader.position < 100


def test_one_that_was_cut_is_read_as_far_as_it_goes_and_that_is_told(tmp_path, capsys):
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    with whole.open("wb") as file:
        writer = McapWriter(file)
        for n in range(50):
            writer.pose("r", PoseStamped(n, Pose(0.0, 0.0, 0.0), n, "a"), n)
            writer.scan("r", "s", scan(n, seq=n, run="a"), n)
            writer.flush()
    cut.write_bytes(whole.read_bytes()[:-3000])
    reader, found = read(cut)
    count = len(found) // 2
    assert 35 < count < 50
    bytes_whole = f"{reader.position} of {cut.stat().st_size} bytes are whole"
    told = f"{bytes_whole}, of the others is read what can be, {count} scans and {count} poses"
    assert reader.doubt.startswith(f"it was cut short, or is still being recorded: {told}")
    run_build(BuildRequest([cut], tmp_path / "map", Settings()))
    said = capsys.readouterr()
    assert f"{count} scans read, {count} integrated" in said.out
    assert said.err.endswith(f"\n{cut}: {reader.doubt}\n")
    run_info(cut, as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["notes"] == [reader.doubt]
    assert found["messages"] == {"r/pose": count, "r/s": count}


def test_one_that_is_being_recorded_is_the_same_in_every_pass(tmp_path):
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.scan("r", "s", scan(0), 0)
        writer.flush()
        reader = log_reader(path, ReadAs(), Settings())
        for n in range(1, 3):
            with reader() as messages:
                assert [each.message.stamp for each in messages] == [0]
            writer.scan("r", "s", scan(n), n)
            writer.flush()
        writer.finish()
    with reader() as messages:
        assert len(list(messages)) == 1
    with log_reader(path, ReadAs(), Settings())() as messages:
        assert len(list(messages)) == 3


def test_one_that_is_damaged_or_holds_no_scan_is_refused(tmp_path):
    path = tmp_path / "a.mcap"
    write_mcap(path, [RecordedPose("r", PoseStamped(1, Pose(0.0, 0.0, 0.0)))])
    with pytest.raises(BadRecording, match=r"a\.mcap: holds no scan, only 1 poses$"):
        read(path)
    write_mcap(path, [RecordedScan("r", "s", scan(n)) for n in range(100)])
    content = bytearray(path.read_bytes())
    content[200] ^= 1
    path.write_bytes(content)
    with pytest.raises(BadRecording, match=r"is damaged: .*ogm record --repair leaves out"):
        read(path)
    with pytest.raises(BadRecording, match="cannot be read"):
        read(tmp_path / "none.mcap")


def test_flags_of_other_logs_are_refused(tmp_path):
    path = tmp_path / "a.mcap"
    write_mcap(path, [RecordedScan("r", "s", scan(1))])
    with pytest.raises(BadRecording, match="are for bags"):
        log_reader(path, ReadAs(bag=BagOptions()), Settings())
    with pytest.raises(BadRecording, match="--odometry is for CARMEN"):
        log_reader(path, ReadAs(odometry=True), Settings())


def test_a_full_disk_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_text("before")
    messages = [RecordedScan("r", "s", scan(n, *np.random.default_rng(n).random(5000))) for n in range(20)]
    with room_for(50_000), pytest.raises(DiskFull, match=r"a\.mcap: cannot be written"):
        write_mcap(path, messages)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_what_it_holds_is_told_like_a_bag(tmp_path, capsys):
    path = tmp_path / "a.mcap"
    said = [RecordedPose("r", PoseStamped(2_000_000_000, Pose(0.0, 0.0, 0.0)))]
    write_mcap(path, [*said, RecordedScan("r", "s", scan(3_000_000_000))])
    run_info(path, as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert (found["kind"], found["missing"]) == ("recording, MCAP", None)
    assert {topic["name"]: topic["messages"] for topic in found["topics"]} == {
        "/ogm/robots/r/pose": 1,
        "/ogm/robots/r/scan/s": 1,
        "/r/s": 1,
        "/tf": 2,
    }
    assert found["messages"] == {"r/pose": 1, "r/s": 1}
    assert found["written"] == {"from_ns": 2_000_000_000, "to_ns": 3_000_000_000}
    run_info(path, as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"{path}: recording, MCAP, 0.0 MB"
    assert "      r/s  (moves)" in lines
