"""What a bag or a log holds, told before a map is made of it."""

import json

import pytest

import mcap_bytes as mcap
from bag_files import drive, edge, mount, scan, tf, write_bag
from ogm_core.errors import BadRecording
from ogm_core.logs.recordings import RecordedPose, write_jsonl
from ogm_core.types import Pose, PoseStamped
from ogm_services.commands.info import run_info


def test_a_bag(tmp_path, capsys):
    bag = write_bag(tmp_path / "bag", [mount(), *drive()])
    run_info(bag, as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "rosbag2, sqlite3"
    assert {topic["name"]: topic["messages"] for topic in found["topics"]} == {
        "/scan": 5,
        "/tf": 6,
        "/tf_static": 1,
    }
    assert found["frames"][""]["laser"] == {"parent": "base_link", "static": True}
    assert found["frames"][""]["base_link"] == {"parent": "odom", "static": False}
    assert found["messages"] == {"robot1/pose": 6, "robot1/scan": 5}
    assert found["written"] == {"from_ns": 0, "to_ns": 600_000_000}
    assert found["stamps"] == {"from_ns": 100_000_000, "to_ns": 600_000_000}
    assert found["missing"] is None
    run_info(bag, as_json=False)
    lines = capsys.readouterr().out.splitlines()
    at = lines.index("frames of /:")
    assert lines[at + 1 : at + 4] == ["  odom", "    base_link  (moves)", "      laser"]
    assert lines[-1] == "missing for a map: nothing"


def test_what_is_missing_for_a_map_is_said(tmp_path, capsys):
    run_info(write_bag(tmp_path / "bag", [scan(0)]), as_json=False)
    shown = capsys.readouterr().out
    assert "missing for a map: holds no tf, so nothing says where its scans were taken" in shown
    run_info(write_bag(tmp_path / "two", [mount(), *drive(), scan(0, topic="/rear")]), as_json=False)
    assert "say which to map by --scan-topic: /rear (1), /scan (5)" in capsys.readouterr().out


def test_what_a_map_would_suffer_from_is_noted(tmp_path, capsys):
    """Before one is made: poses that drift, and lines that are no messages."""
    bag = write_bag(tmp_path / "bag", [mount(), *drive()])
    run_info(bag, as_json=True)
    (drifting,) = json.loads(capsys.readouterr().out)["notes"]
    assert drifting.startswith("robot1: there is no map frame: its poses are odometry")
    log = tmp_path / "log.jsonl"
    write_jsonl(log, [RecordedPose("r1", PoseStamped(7, Pose(0.0, 0.0, 0.0)))])
    log.write_text(log.read_text() + "[]\n")
    run_info(log, as_json=False)
    shown = capsys.readouterr().out
    assert "\nnote: 1 malformed lines (" in shown
    assert "\nmissing for a map: holds no scan, only 1 poses" in shown


def test_channels_that_are_not_of_ros_are_listed_too(tmp_path, capsys):
    """With how they are written, as what a map can be made of is listed without."""
    names = mcap.schema(1, "sensor_msgs/msg/LaserScan") + mcap.channel(1, 1, "/scan")
    names += mcap.schema(2, "foxglove.LaserScan") + mcap.channel(2, 2, "/other", "json")
    (tmp_path / "a.mcap").write_bytes(mcap.whole(names, mcap.message(2, 5, b"{}")))
    run_info(tmp_path / "a.mcap", as_json=False)
    shown = capsys.readouterr().out
    assert "         0  /scan  sensor_msgs/msg/LaserScan\n" in shown
    assert "         1  /other  foxglove.LaserScan, json\n" in shown
    assert "missing for a map: holds no LaserScan; there are /other (foxglove.LaserScan, json)" in shown


def test_long_lists_end_in_a_screen(tmp_path, capsys):
    """JSON has all of them."""
    rear = [scan(0, topic=f"/rear{n}") for n in range(40)]
    bag = write_bag(tmp_path / "bag", [mount(), *drive(), *rear])
    run_info(bag, as_json=False)
    shown = capsys.readouterr().out
    assert "  and 20 more (--json has all)" in shown
    assert len(shown.splitlines()) < 40
    run_info(bag, as_json=True)
    assert len(json.loads(capsys.readouterr().out)["topics"]) == 43


def test_a_bag_of_many_robots_fits_a_screen(tmp_path, capsys):
    """Whatever their frames are called, and however deep they lie."""
    chain = [tf(0, *(edge(0, f"{n}" * 200, f"{n + 1}" * 200) for n in range(1, 60)), topic="/tf_static")]
    robots = [tf(0, edge(0, "odom", "base_link"), topic=f"/r{n}/tf") for n in range(300)]
    run_info(write_bag(tmp_path / "bag", [*chain, *drive(), *robots]), as_json=False)
    lines = capsys.readouterr().out.splitlines()
    assert "  and those of more namespaces (--json has all)" in lines
    assert len(lines) < 100
    assert max(len(line) for line in lines[:-1] if not line.startswith("note: ")) < 250
    assert sum(line.startswith("note: ") for line in lines) < 30


def test_a_recording(tmp_path, capsys):
    log = tmp_path / "log.jsonl"
    write_jsonl(log, [RecordedPose("r1", PoseStamped(7, Pose(0.0, 0.0, 0.0)))])
    run_info(log, as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert (found["messages"], found["missing"]) == ({"r1/pose": 1}, "holds no scan, only 1 poses")
    with pytest.raises(BadRecording, match="cannot be read"):
        run_info(tmp_path / "none.jsonl", as_json=False)
