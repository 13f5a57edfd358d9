"""`ogm build --each`: every log as if it were built alone; one without a map keeps no other from its own."""

from pathlib import Path

import pytest

from ogm_core.errors import BadInput, BadRecording
from ogm_core.logs.jsonl_writer import write_jsonl
from ogm_services.commands import build
from ogm_services.commands.build_each import LogsFailed, folders_of, run_each
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.settings.sources import load_settings
from rough_log import SCANS, Drive, write_three_logs

FILES = ("map.npz", "map.png", "map.pgm", "map.yaml", "quality.json")


@pytest.fixture
def settings():
    return load_settings(config=None, flags={}, environ={})


@pytest.mark.parametrize("workers", [1, 2])
def test_each_folder_is_that_of_a_build_of_one_log(tmp_path, settings, workers, capsys):
    logs = write_three_logs(tmp_path)
    for log in logs:
        build.run_build(
            BuildRequest([log], tmp_path / "alone" / log.stem, settings, held=HeldScans(5), world="lab")
        )
    alone = capsys.readouterr().out.replace(f"{tmp_path}/alone", f"{tmp_path}/each")
    run_each(BuildRequest(logs, tmp_path / "each", settings, held=HeldScans(5), world="lab", workers=workers))
    assert capsys.readouterr().out == alone
    assert sorted(path.name for path in (tmp_path / "each").iterdir()) == ["monday", "tuesday", "wednesday"]
    for log in logs:
        for name in FILES:
            made, expected = (tmp_path / folder / log.stem / name for folder in ("each", "alone"))
            assert made.read_bytes() == expected.read_bytes(), made


def test_logs_that_give_no_map_are_told_of_and_the_others_are_mapped(tmp_path, settings, capsys):
    logs = write_three_logs(tmp_path)
    empty, lost = tmp_path / "empty.jsonl", tmp_path / "lost.jsonl"
    empty.write_text("")
    write_jsonl(lost, [message for _, message in Drive("lost").scans(SCANS[:3]).sent])
    with pytest.raises(LogsFailed, match=r"^2 of 4 logs gave no map: see above$"):
        run_each(BuildRequest([empty, logs[1], lost, logs[2]], tmp_path / "each", settings))
    said = capsys.readouterr()
    assert [line.split(": ")[0] for line in said.out.splitlines()] == [
        str(tmp_path / "each" / "tuesday"),
        str(tmp_path / "each" / "wednesday"),
    ]
    errors = [line for line in said.err.splitlines() if line.startswith("ogm: ")]
    assert errors[0].startswith(f"ogm: {empty}: ")
    assert "holds no scan" in errors[0]
    assert errors[1].startswith(f"ogm: {lost}: no scan changed the map")
    with pytest.raises(BadInput, match=r"^1 of 2 logs gave no map"):
        run_each(BuildRequest([empty, logs[1]], tmp_path / "each", settings))


def test_paths_are_told_of_as_they_were_given(tmp_path, monkeypatch, settings, capsys):
    write_three_logs(tmp_path)
    monkeypatch.chdir(tmp_path)
    logs = [Path(f"{name}.jsonl") for name in ("monday", "tuesday")]
    run_each(BuildRequest(logs, Path("maps"), settings, workers=2))
    said = capsys.readouterr().out.splitlines()
    assert [line.partition(": ")[0] for line in said] == ["maps/monday", "maps/tuesday"]
    with pytest.raises(BadRecording, match=r"^nothere\.jsonl: cannot be read"):
        build.run_build(BuildRequest([logs[0], Path("nothere.jsonl")], Path("week"), settings, workers=2))


def test_folders_are_named_after_logs_and_two_logs_have_two(tmp_path, settings):
    (tmp_path / "bag.2").mkdir()
    names = ["a.log.gz", "b.c.jsonl", "d.mcap", "bag.2"]
    folders = folders_of([tmp_path / name for name in names], tmp_path / "out")
    assert folders == [tmp_path / "out" / name for name in ("a", "b.c", "d", "bag.2")]
    with pytest.raises(
        BadInput, match=r"x/a\.log and .*y/a\.jsonl would both be written into .*out/a: rename"
    ):
        folders_of([tmp_path / "x/a.log", tmp_path / "y/a.jsonl"], tmp_path / "out")
    with pytest.raises(BadInput, match="is given twice"):
        run_each(BuildRequest([tmp_path / "a.log", tmp_path / "a.log"], tmp_path / "out", settings))
