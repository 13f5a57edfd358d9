"""Stores of every format that a version has written: this one goes on with each, and refuses newer ones."""

import json
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from ogm_client import RobotPublisher
from ogm_services.mapper.storage.layout import VERSION

STORES = Path(__file__).parents[1] / "older_stores"
sys.path.insert(0, str(STORES))
from write import OF_FORMAT, RUN, SCANS, publish  # noqa: E402

FORMATS = sorted(path for path in STORES.glob("format*"))
NEWEST = pytest.mark.parametrize("older", FORMATS[-1:], ids=lambda path: path.name, indirect=True)


@pytest.fixture(params=FORMATS, ids=lambda path: path.name)
def older(request, tmp_path):
    """What a version of ogm has left: a copy of the store; the map that was served, the status; its flags."""
    (tmp_path / "data").mkdir()
    shutil.copy(request.param / "map.sqlite", tmp_path / "data/map.sqlite")
    with np.load(request.param / "map.npz") as served:
        status = json.loads((request.param / "status.json").read_text())
        flags = OF_FORMAT[int(request.param.name.removeprefix("format"))]
        return tmp_path / "data", dict(served), status, ("--data", tmp_path / "data", *flags)


def test_there_is_a_store_of_every_format_that_ever_was():
    assert {path.name for path in FORMATS} == {f"format{number}" for number in range(1, VERSION + 1)}
    assert sum(file.stat().st_size for path in FORMATS for file in path.iterdir()) < 70_000 * VERSION


@NEWEST
def test_a_store_that_another_program_has_open_is_not_called_damaged(ogm, older):
    data, _, _, flags = older
    with closing(sqlite3.connect(data / "map.sqlite")) as connection:
        connection.execute("PRAGMA locking_mode = EXCLUSIVE")
        connection.execute("BEGIN IMMEDIATE")
        complaint = ogm.mapper(*flags).wait().complaint(1)
    assert complaint == f"ogm: {data}/map.sqlite: another program has it open: end that first\n"


def test_a_mapper_goes_on_with_it_cell_by_cell_and_knows_what_was_decided(
    ogm, eventually, older, assert_equal_maps
):
    _, served, told, flags = older
    if "--half-life" in flags:  # map.npz tells of it, by now
        served["half_life"] = np.array(float(flags[flags.index("--half-life") + 1]))
    mapper = ogm.ready(ogm.mapper(*flags))
    same = ("epoch", "revision", "stamp", "map_info")
    assert {name: mapper.status()[name] for name in same} == {name: told[name] for name in same}
    assert_equal_maps(mapper.map(), served)

    with RobotPublisher("r1", address=mapper.endpoint, run=RUN, reliable=True) as robot:
        robot.wait_for_mapper(30.0)
        publish(robot, 0, SCANS + 3)  # the first of them under seqs that it has had
        eventually(lambda: mapper.status()["revision"] == told["revision"] + 3)
    scans = mapper.status()["scans"]
    duplicate = scans["dropped"]["duplicate"]  # by themselves; others, or all, come again from the cache
    assert duplicate <= SCANS <= duplicate + scans["replayed"]
    assert (scans["integrated"], scans["received"]) == (3, 3 + duplicate)
    cells = mapper.map()
    assert mapper.command.stop().code == 0
    assert_equal_maps(ogm.ready(ogm.mapper(*flags)).map(), cells)


@NEWEST
def test_a_store_of_a_newer_format_is_refused_in_a_line_that_names_both(ogm, older):
    data, _, _, flags = older
    with closing(sqlite3.connect(data / "map.sqlite")) as connection:
        connection.execute(f"PRAGMA user_version = {VERSION + 1}")
    complaint = ogm.mapper(*flags).wait().complaint(2)
    assert f"in format {VERSION + 1}; this one reads format {VERSION}: use the newer one" in complaint
