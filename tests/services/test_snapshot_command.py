"""`ogm snapshot`, and `ogm get --at`, of a running mapper, over HTTP and Zenoh."""

import json
import os
import re
from dataclasses import replace

import pytest
from rich.console import Console
from typer.testing import CliRunner

from ogm_core.status import SnapshotInfo
from ogm_services.cli import app
from ogm_services.commands.snapshot import snapshots_table

TOKEN = "correct-horse-battery-staple"


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    for name in [name for name in os.environ if name.startswith("OGM_")]:
        monkeypatch.delenv(name)


@pytest.fixture
def keeping(start_mapper, tmp_path):
    """A mapper that stores its map, with the cross in it, and whose writes over HTTP need TOKEN."""
    sections = {
        "map": {"resolution": 0.5},
        "mapper": {"data": str(tmp_path / "data")},
        "http": {"token": TOKEN},
    }
    with start_mapper(**sections) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture
def token_file(tmp_path):
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    return file


def ogm(*args):
    return CliRunner().invoke(app, [str(arg) for arg in args], prog_name="ogm", catch_exceptions=False)


def told(*args):
    """What a command printed that went well."""
    result = ogm(*args)
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    return result.stdout


def complaint(code, *args):
    """The one line of a command that ended with `code`."""
    result = ogm(*args)
    assert (result.exit_code, result.stdout) == (code, ""), result.output
    assert re.fullmatch(r"ogm: [^\n]+\n", result.stderr), result.stderr
    return result.stderr


@pytest.mark.parametrize("way", ["http", "zenoh"])
def test_a_map_is_saved_listed_fetched_restored_and_deleted(keeping, token_file, tmp_path, way):
    if way == "http":
        where = ["--url", str(keeping.http.base_url), "--map", "hall"]
        writing = [*where, "--token-file", token_file]
    else:
        where = writing = ["--url", keeping.endpoint, "--map", "hall"]
    then = keeping.http.get("/map.npz").content
    assert told("snapshot", "list", *where) == "no map is saved\n"
    assert re.fullmatch(r"noon: revision 3, \d\.\d MB\n", told("snapshot", "save", "noon", *writing))
    keeping.draw_cross(revision=3)
    saved = json.loads(told("snapshot", "save", "later", "--json", *writing))
    assert (saved["name"], saved["revision"]) == ("later", 6)
    listed = json.loads(told("snapshot", "list", "--json", *where))
    assert listed == keeping.http.get("/snapshots").json()
    assert [one["name"] for one in listed["snapshots"]] == ["later", "noon"]
    rows = told("snapshot", "list", *where).splitlines()[3:5]
    assert [(row.split()[0], row.split()[3]) for row in rows] == [("later", "6"), ("noon", "3")]

    told("get", "map.npz", "--at", "noon", "-o", tmp_path / "noon.npz", *where)
    assert (tmp_path / "noon.npz").read_bytes() == then
    told("get", "map.yaml", "--at", "noon", "-o", tmp_path / "noon.yaml", *where)
    assert (tmp_path / "noon.pgm").read_bytes() == keeping.http.get("/map.pgm?at=noon").content

    said = told("snapshot", "restore", "noon", *writing)
    status = keeping.status()
    assert said == f"noon: the map goes on from it, now at revision 3, epoch {status['epoch']}\n"
    assert keeping.http.get("/map.npz").content == then
    again = json.loads(told("snapshot", "restore", "noon", "--json", *writing))
    assert again["epoch"] == keeping.status()["epoch"] != status["epoch"]

    assert told("snapshot", "delete", "noon", *writing) == "noon: deleted\n"
    left = json.loads(told("snapshot", "delete", "later", "--json", *writing))
    assert left == {"snapshots": []}


def test_what_is_wrong_with_a_name_is_exit_2_and_what_fails_exit_1(keeping, token_file, tmp_path, cross):
    where = ["--url", str(keeping.http.base_url)]
    writing = [*where, "--token-file", token_file]
    told("snapshot", "save", "noon", *writing)
    assert "there is a snapshot of this name" in complaint(2, "snapshot", "save", "noon", *writing)
    for command in ("restore", "delete"):
        said = complaint(2, "snapshot", command, "moon", *writing)
        assert said == "ogm: name moon: there is no such snapshot; there are: noon\n"
        assert "it carries no token" in complaint(1, "snapshot", command, "noon", *where)
    out = tmp_path / "x.png"
    assert "no such snapshot" in complaint(2, "get", "map.png", "--at", "moon", "-o", out, *where)
    file = tmp_path / "data" / "snapshots" / "noon.sqlite"
    file.write_bytes(file.read_bytes()[:5000])
    assert "noon.sqlite is damaged" in complaint(1, "snapshot", "restore", "noon", *writing)
    assert "noon.sqlite is damaged" in complaint(1, "get", "map.png", "--at", "noon", "-o", out, *where)
    assert not out.exists()
    for command in (["list"], ["save", "a"], ["restore", "a"], ["delete", "a"]):
        said = complaint(1, "snapshot", *command, "--url", str(cross.http.base_url))
        assert "this mapper stores no map" in said
    assert "cannot connect" in complaint(1, "snapshot", "list", "--url", "http://127.0.0.1:9")


def test_the_token_is_that_of_the_settings_unless_a_file_is_given(keeping, token_file, tmp_path, monkeypatch):
    where = ["--url", str(keeping.http.base_url)]
    monkeypatch.setenv("OGM_HTTP__TOKEN", TOKEN)
    told("snapshot", "save", "a", *where)
    monkeypatch.setenv("OGM_HTTP__TOKEN", TOKEN[::-1])
    assert "its token is not the mapper's" in complaint(1, "snapshot", "save", "b", *where)
    told("snapshot", "save", "b", *where, "--token-file", token_file)
    told("snapshot", "save", "c", "--url", keeping.endpoint, "--map", "hall")
    token_file.write_text("short")
    said = complaint(2, "snapshot", "save", "d", *where, "--token-file", token_file)
    assert said.startswith(f"ogm: --token-file: {token_file}: a token of 16 to 512 ")
    assert "short" not in said


def test_the_table_says_what_is_damaged():
    good = SnapshotInfo("noon", "e", "r", 12, None, 10**18, 1_234_567)
    bad = replace(good, name="moon", damage="moon.sqlite is damaged: it is empty")

    def rows(*found):
        with (console := Console(width=200)).capture() as capture:
            console.print(snapshots_table(list(found)))
        return [re.split(r"\s{2,}", line.strip()) for line in capture.get().splitlines() if line.strip("─ ")]

    head, row = rows(good)
    assert head == ["snapshot", "saved", "revision", "newest scan", "MB"]
    assert (row[0], row[2:]) == ("noon", ["12", "none", "1.2"])
    head, row, _ = rows(bad, good)
    assert (head[-1], row[0], row[2:]) == ("damage", "moon", ["1.2", bad.damage])
