"""`ogm get` and `ogm status`: whom they ask, and what they make of the answer."""

import json
import os
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

from ogm_client import MapperError
from ogm_client.session import NetworkConfig
from ogm_client.status_reply import read_status
from ogm_core.files.file_names import ros_map_names
from ogm_core.lattice import Region
from ogm_core.placing.receipts import DROP_REASONS
from ogm_core.status import PoseCounts, ScanCounts
from ogm_services.cli import app
from ogm_services.commands.status import status_tables
from ogm_services.replies.what_helps import LOST_HELPS, ON_ROBOTS_MEANS, WHAT_HELPS
from status_json import STATUS as FULL_STATUS

STATUS = {
    "map": "hall",
    "epoch": "e1",
    "run": "p1",
    "revision": 41,
    "stamp": 1_700_000_000_500_000_000,
    "scans": {
        "received": 50,
        "integrated": 41,
        "pending": 2,
        "dropped": {"malformed": 0, "no_pose": 7, "duplicate": 0, "stale": 0, "overload": 0},
    },
    "poses": {"received": 60, "malformed": 1, "late": 3},
    "other": {"ignored": 5},
    "map_info": {"known_cells": 1234, "bytes": 2_500_000, "width": 400, "height": 300, "resolution": 0.05},
    "robots": {
        "r1": {
            "pose": [1.0, -2.5, 3.14159],
            "stamp": 1_700_000_000_500_000_000,
            "alive": True,
            "age_s": 0.25,
            "sources": {
                "back": {
                    "run": "a",
                    "last_seq": 9,
                    "received": 10,
                    "pending": 0,
                    "integrated": 8,
                    "dropped": {"superseded": 1, "stale": 1},
                    "hints": ["range_max"],
                },
                "front": {"run": "a", "last_seq": None, "received": 35, "pending": 2, "integrated": 33},
            },
        },
        "r2": {"pose": None, "stamp": None, "alive": True, "age_s": None, "sources": {}},
        "r3": {"pose": [0.0, 0.0, 0.0], "stamp": 1, "alive": False, "age_s": 61.0, "sources": {}},
    },
    "uptime_s": 12.3,
}


@dataclass
class FakeGrid:
    region: Region | None

    def save_ros_map(self, path):
        picture, description = ros_map_names(Path(path))
        picture.write_bytes(b"pgm")
        description.write_bytes(b"yaml")


class FakeClient:
    """Answers what a mapper would; keeps what it was asked in `asked`."""

    asked: list

    def __init__(self, address=None, *, map_name, zenoh_config=None, session=None):
        where = NetworkConfig.of_client(address, zenoh_config) if zenoh_config else address
        FakeClient.asked = [(session or where, map_name)]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def fetch(self, name, /, **parameters):
        if "palette" in parameters and parameters["palette"] == "pink":
            raise MapperError("bad-parameter", 400, "palette: ros or probability")
        if name == "map.pgm":
            raise MapperError("map-empty", 404, "there is no known cell yet")
        self.asked.append((name, parameters))
        return json.dumps(STATUS).encode() if name == "status" else b"\x89PNG"

    def get_map(self, region=None, *, at=None, partial=False):
        self.asked.append(("map", region) if at is None else ("map", region, at))
        return FakeGrid(region)

    def status(self):
        return read_status(json.dumps(STATUS).encode())


@pytest.fixture
def ogm():
    def ogm(*args):
        return CliRunner().invoke(app, [str(arg) for arg in args], prog_name="ogm", catch_exceptions=False)

    return ogm


@pytest.fixture
def mapper(monkeypatch):
    for name in [name for name in os.environ if name.startswith("OGM_")]:
        monkeypatch.delenv(name)
    monkeypatch.setattr("ogm_client.MapClient", FakeClient)
    monkeypatch.setattr("ogm_services.commands.mapper_client.open_session", nullcontext)
    return FakeClient


def test_get_writes_a_file(ogm, mapper, tmp_path):
    out = tmp_path / "a.png"
    result = ogm("get", "map.png?palette=probability&max_size=500", "-o", out)
    assert (result.exit_code, result.output) == (0, "")
    assert out.read_bytes() == b"\x89PNG"
    assert mapper.asked == [
        ("tcp/127.0.0.1:7447", None),
        ("map.png", {"palette": "probability", "max_size": "500"}),
    ]


def test_get_a_map_as_it_was_saved(ogm, mapper, tmp_path):
    assert ogm("get", "map.png?max_size=9", "--at", "monday", "-o", tmp_path / "a.png").exit_code == 0
    assert ogm("get", "map.yaml", "--at", "monday", "-o", tmp_path / "a.yaml").exit_code == 0
    assert FakeClient.asked[1:] == [("map", None, "monday")]
    assert ogm("get", "map.pgm?at=monday", "--at", "monday", "-o", tmp_path / "a.pgm").exit_code == 1
    assert ogm("get", "map.png?at=monday&region=0,0,1,1", "-o", tmp_path / "b.png").exit_code == 0
    assert FakeClient.asked[1:] == [("map.png", {"at": "monday", "region": "0,0,1,1"})]


def test_get_to_stdout(ogm, mapper):
    result = ogm("get", "map.png", "-o", "-", "--url", "http://h:1", "--map", "hall")
    assert (result.exit_code, result.stdout_bytes) == (0, b"\x89PNG")
    assert mapper.asked[0] == ("http://h:1", "hall")


@pytest.mark.parametrize("command", [["get", "map.png", "-o", "-"], ["status", "--json"]])
def test_whom_they_ask_is_said_by_flags_environment_and_settings_file(
    ogm, mapper, tmp_path, monkeypatch, command
):
    zenoh, config = tmp_path / "zenoh.json5", tmp_path / "ogm.yaml"
    zenoh.write_text("{}")
    config.write_text("network: {map_name: hall, connect: [tcp/h:1]}\n")

    def asked(*flags):
        assert ogm(*command, *flags).exit_code == 0
        return mapper.asked[0]

    assert asked("--config", config) == ("tcp/h:1", "hall")
    assert asked("--config", config, "--map", "x", "--url", "tcp/h:2") == ("tcp/h:2", "x")
    assert asked("--zenoh-config", zenoh) == (NetworkConfig(config_file=zenoh), None)
    assert asked("--zenoh-config", zenoh, "--url", "tcp/h:2")[0] == NetworkConfig(
        connect=("tcp/h:2",), config_file=zenoh
    )
    assert asked("--zenoh-config", zenoh, "--url", "http://h:2")[0] == "http://h:2"
    monkeypatch.setenv("OGM_NETWORK__CONNECT", "tcp/h:3,tcp/h:4")
    monkeypatch.setenv("OGM_NETWORK__MAP_NAME", "yard")
    assert asked("--config", config) == (NetworkConfig(connect=("tcp/h:3", "tcp/h:4")), "yard")
    monkeypatch.setenv("OGM_NETWORK__NAME", "yard")
    refused = ogm(*command)
    assert refused.exit_code == 2
    assert "OGM_NETWORK__NAME: unknown setting" in refused.stderr


@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("map.png", "map.png"),
        ("/map.png?palette=probability", "map.png"),
        ("map.json?region=0,0,1,1", "map.json"),
        ("cell?x=1&y=2", "cell.json"),
        ("status", "status.json"),
        ("map.yaml", "map.pgm map.yaml"),
    ],
)
def test_without_a_file_it_is_called_what_it_is(ogm, mapper, tmp_path, monkeypatch, name, files):
    monkeypatch.chdir(tmp_path)
    result = ogm("get", name)
    assert (result.exit_code, result.stdout, result.stderr) == (0, f"{files}\n", "")
    assert " ".join(sorted(path.name for path in tmp_path.iterdir())) == files


@pytest.mark.parametrize("out", ["hall.yaml", "hall.pgm", "hall"])
def test_a_ros_map_is_named_by_either_of_its_files(ogm, mapper, tmp_path, out):
    assert ogm("get", "map.yaml", "-o", tmp_path / out).exit_code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["hall.pgm", "hall.yaml"]


@pytest.mark.parametrize(
    ("name", "out", "wanted"),
    [
        ("map.png", "a.jpg", "png"),
        ("map.png", "A.JPEG", "png"),
        ("map.png?palette=probability", "a.pgm", "png"),
        ("map.npz", "a.png", "npz"),
        ("status", "a.yaml", "json"),
        ("map.yaml", "a.png", "yaml"),
    ],
)
def test_a_name_that_says_another_format_is_refused(ogm, mapper, tmp_path, name, out, wanted):
    result = ogm("get", name, "-o", tmp_path / out)
    assert (result.exit_code, result.stdout) == (2, "")
    assert result.stderr == (
        f"ogm: {tmp_path / out}: a file of this name is no {wanted} file: end it in .{wanted}\n"
    )
    assert list(tmp_path.iterdir()) == []
    for other in ("picture", "floor.2", f"b.{wanted.upper()}"):
        assert ogm("get", name, "-o", tmp_path / other).exit_code == 0


def test_names_that_are_no_text_are_written_where_no_text_is_needed(ogm, mapper, tmp_path):
    out = tmp_path / os.fsdecode(b"\xff.png")
    assert ogm("get", "map.png", "-o", out).exit_code == 0
    assert out.read_bytes() == b"\x89PNG"
    for command in (
        ("get", "map.yaml", "-o", tmp_path / os.fsdecode(b"\xff.yaml")),
        ("get", os.fsdecode(b"map.png?palette=\xff"), "-o", tmp_path / "a.png"),
        ("get", os.fsdecode(b"map.\xff"), "-o", tmp_path / "a.png"),
    ):
        result = ogm(*command)
        assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1)
        assert "is not UTF-8 text: choose another name" in result.stderr
    assert list(tmp_path.iterdir()) == [out]


def test_get_map_yaml_brings_its_picture_from_the_same_map(ogm, mapper, tmp_path):
    assert ogm("get", "map.yaml?t=1&region=-1,-2,3,4&t=2", "-o", tmp_path / "hall.yaml").exit_code == 0
    assert (tmp_path / "hall.yaml").read_bytes() == b"yaml"
    assert (tmp_path / "hall.pgm").read_bytes() == b"pgm"
    assert mapper.asked[1:] == [("map", Region(-1.0, -2.0, 3.0, 4.0))]


@pytest.mark.parametrize(
    ("name", "out", "text"),
    [
        ("map.png", "/nowhere/a.png", "/nowhere/a.png: cannot be written: No such file or directory"),
        ("map.yaml", "/nowhere/a.yaml", "/nowhere/a.yaml: cannot be written"),
        ("map.yaml", "-", "-o FILE.yaml"),
        ("map.yaml?palette=ros", "a.yaml", "not palette"),
        ("map.yaml?complete=2", "a.yaml", "complete: 0 or 1 is needed, got '2'"),
        ("map.yaml?region=1,2", "a.yaml", "region: four numbers"),
        ("map.png?palette", "a.png", "KEY=VALUE"),
        ("map.png?max_size=1&max_size=2", "a.png", "once"),
        ("map.png?palette=pink", "a.png", "palette: ros or probability"),
    ],
)
def test_get_refuses_bad_input(ogm, mapper, name, out, text):
    result = ogm("get", name, "-o", out)
    assert (result.exit_code, result.stdout) == (2, "")
    assert text in result.stderr


def test_a_disk_that_is_full_leaves_the_old_file(ogm, mapper, tmp_path, disk_full):
    out = tmp_path / "a.png"
    out.write_bytes(b"before")
    result = ogm("get", "map.png", "-o", out)
    assert (result.exit_code, result.stdout) == (1, "")
    assert result.stderr == f"ogm: -o {out}: cannot be written: No space left on device\n"
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.png", b"before")]


def test_what_the_mapper_cannot_answer_is_a_failure_at_run_time(ogm, mapper, tmp_path):
    result = ogm("get", "map.pgm", "-o", tmp_path / "a.pgm")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "no known cell" in result.stderr
    assert not (tmp_path / "a.pgm").exists()


def test_status_as_json(ogm, mapper):
    assert json.loads(ogm("status", "--json").stdout) == STATUS


def test_status_as_a_table(ogm, mapper):
    result = ogm("status")
    assert result.exit_code == 0
    lines = [line.split() for line in result.stdout.splitlines()]
    rows = {line[0]: line[1:] for line in lines if line}
    assert rows["map"] == ["hall"]
    assert (rows["epoch"], rows["run"], rows["revision"]) == (["e1"], ["p1"], ["41"])
    assert " ".join(rows["scans"]) == "50 received, 41 integrated, 2 pending"
    assert " ".join(rows["dropped"]) == "7 no_pose"
    assert " ".join(rows["poses"]) == "60 received, 1 malformed, 3 late"
    assert rows["stamp"][0] in ("2023-11-14", "2023-11-15")  # 22:13:20 UTC, shown in local time
    assert rows["stamp"][1][2:12] == ":13:20.500" or rows["stamp"][1][5:12] == ":20.500"
    assert " ".join(rows["size"]) == "400 x 300 cells of 0.05 m"
    assert " ".join(rows["r1"]) == "yes 0.2 s ago 1.00 -2.50 3.14"
    assert rows["r2"] == ["yes"]
    assert "r3" not in rows, "gone for more than a minute"
    assert rows["r1/front"] == ["35", "33", "2", "0"]
    of_back = [line[1:] for line in lines if line and line[0] == "r1/back"]
    assert of_back[0] == ["10", "8", "0", "2", "9"]
    assert [" ".join(line[:2]) for line in of_back[1:]] == ["1 superseded", "1 stale", "hint: range_max"]
    text = " ".join(result.stdout.split())
    assert "another publisher has taken over the robot's name" in text
    assert "give every robot" in text


def test_what_is_lost_and_what_came_again_stand_in_the_tables():
    console = Console(record=True, width=200)
    for table in status_tables(FULL_STATUS):
        console.print(table)
    lines = [" ".join(line.split()) for line in console.export_text().splitlines()]
    assert {"lost 8 scans, 10 poses", "replayed 9 scans, 11 poses", "on robots 12 beams"} <= set(lines)
    assert {f"r2/front 8 lost {LOST_HELPS}", f"r2/front 13 beams on robots {ON_ROBOTS_MEANS}"} <= set(lines)
    quiet = replace(FULL_STATUS, scans=ScanCounts(0, 0, 0, {}), poses=PoseCounts(0, 0, 0), robots={})
    console.print(status_tables(quiet)[0])
    assert not {"lost", "replayed", "robots"} & set(console.export_text().split())


def test_every_reason_has_a_cure():
    assert set(WHAT_HELPS) == set(DROP_REASONS)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        *(
            (name, "cannot be fetched, only map.png, ")
            for name in ("map.gif", "MAP.PNG?t=1", "/map", "", "cells")
        ),
        ("http://joe:secret@h:1/map.png", "NAME says what to fetch, such as map.png; --url where from"),
    ],
)
def test_a_name_that_nothing_has_is_refused_whether_or_not_a_mapper_is_there(name, says):
    ended = CliRunner().invoke(app, ["get", name, "--url", "tcp/127.0.0.1:1"], prog_name="ogm")
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert says in ended.stderr
    assert ended.stderr.count("\n") == 1
    assert "secret" not in ended.stderr
