"""`ogm build` of several logs: one map, in which each is placed as if it were alone."""

import json
from dataclasses import replace

import pytest

from ogm_core.errors import BadInput, BadRecording, MapEmpty
from ogm_core.logs.jsonl_writer import write_jsonl
from ogm_core.logs.recordings import RecordingReader
from ogm_services.commands.build import run_build
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.settings.sources import load_settings
from rough_log import SCANS, Drive, write_three_logs

FILES = ("map.npz", "map.png", "map.pgm", "map.yaml", "quality.json")


def settings_of(robots=(), **flags):
    return load_settings(config=None, flags={"map": flags}, environ={}, robots=robots)


@pytest.fixture
def logs(tmp_path):
    return write_three_logs(tmp_path)


def as_one(logs, path):
    """A log with the messages of all, whose robots have different names."""
    messages = []
    for number, log in enumerate(logs):
        with RecordingReader(log) as reader:
            messages += [replace(message, robot=f"{message.robot}{number}") for message in reader]
    write_jsonl(path, messages)
    return path


def files_of(folder):
    return {name: (folder / name).read_bytes() for name in FILES}


@pytest.mark.parametrize(
    "flags",
    [{}, {"half_life": 2.0}, {"cell_model": "rate"}, {"bounds": "-9,-10,9,10", "outside": "drop"}],
    ids=str,
)
def test_several_logs_make_the_map_of_one_with_the_messages_of_all(tmp_path, logs, flags):
    settings = settings_of(**flags)
    run_build(BuildRequest(logs, tmp_path / "several", settings))
    run_build(BuildRequest([as_one(logs, tmp_path / "one.jsonl")], tmp_path / "one", settings))
    assert files_of(tmp_path / "several") == files_of(tmp_path / "one")
    assert not (tmp_path / "one" / "logs.json").exists()


def test_what_is_told_of_each_log(tmp_path, logs, capsys):
    run_build(BuildRequest(logs, tmp_path / "out", settings_of(), held=HeldScans(5)))
    said, told = capsys.readouterr().out.splitlines(), json.loads((tmp_path / "out/logs.json").read_text())
    assert list(told) == [str(log) for log in logs]
    first, second, third = told.values()
    assert first["dropped"]["duplicate"] == 7
    assert second == {
        "scans": 40,
        "integrated": 32,
        "held_out": 8,
        "dropped": {},
        "beams_on_robots": 0,
        "odd_poses": {},
        "malformed": 0,
        "not_read": "",
    }
    assert (third["scans"], third["held_out"]) == (25, 5)
    for line, log, one in zip(said, logs, told.values(), strict=False):
        assert line.startswith(f"{log}: {one['scans']} scans read, {one['integrated']} integrated, ")
    scans, integrated = (sum(one[name] for one in told.values()) for name in ("scans", "integrated"))
    assert said[3:] == [f"{tmp_path}/out: 3 logs, {scans} scans read, {integrated} integrated"]
    assert json.loads((tmp_path / "out/quality.json").read_text())["scans"] == integrated
    run_build(BuildRequest(logs[1:2], tmp_path / "out", settings_of()))
    assert not (tmp_path / "out/logs.json").exists()


def test_what_is_wrong_with_a_log_is_told_with_its_name(tmp_path, logs, capsys):
    run_build(BuildRequest(logs, tmp_path / "out", settings_of(robots=["mounted:radius=0.3"])))
    lines = capsys.readouterr().err.splitlines()
    assert all(line.startswith((f"{logs[0]}: ", f"{logs[1]}: ", f"{logs[2]}: ")) for line in lines)
    nobody = "robots: mounted: no robot of this log is called so"
    assert [line for line in lines if nobody in line] == [f"{log}: {nobody}" for log in logs[1:]]


def test_a_figure_names_a_robot_of_each_log(tmp_path, logs):
    run_build(BuildRequest(logs[1:], tmp_path / "out", settings_of(), figure=tmp_path / "map.svg"))
    drawn = (tmp_path / "map.svg").read_text()
    assert "path of plain in tuesday.jsonl" in drawn
    assert "path of plain in wednesday.jsonl" in drawn
    assert "tuesday.jsonl and 1 more" in drawn


def test_what_several_logs_are_refused_for(tmp_path, logs):
    with pytest.raises(
        BadInput, match=r"tuesday\.jsonl: this log is given twice: its scans would count twice"
    ):
        run_build(
            BuildRequest(
                [logs[1], logs[0], tmp_path / "." / "tuesday.jsonl"], tmp_path / "out", settings_of()
            )
        )
    (tmp_path / "empty.jsonl").write_text("")
    with pytest.raises(BadRecording, match=r"empty\.jsonl: .*holds no scan"):
        run_build(BuildRequest([*logs, tmp_path / "empty.jsonl"], tmp_path / "out", settings_of()))
    lost = [tmp_path / "lost1.jsonl", tmp_path / "lost2.jsonl"]
    for log in lost:
        write_jsonl(log, [message for _, message in Drive("lost").scans(SCANS[:3]).sent])
    with pytest.raises(MapEmpty, match=r"lost1.jsonl: no scan changed the map .*; .*lost2.jsonl: no scan"):
        run_build(BuildRequest(lost, tmp_path / "out", settings_of()))
    assert not (tmp_path / "out").exists()
