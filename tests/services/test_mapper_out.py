"""What a mapper with `--out` leaves: its map first, then the figures that get done in time."""

import json
import sys
import threading
import time

import numpy as np
import pytest

from ogm_core.errors import DiskFull
from ogm_core.quality.figures import Consistency
from ogm_core.types import Pose, Scan
from ogm_services.mapper import last_map
from ogm_services.mapper.last_map import FIGURES_TIME
from ogm_services.mapper.service import MapperService, run_mapper
from ogm_services.settings.settings import Settings

MAP = {"map.png", "map.pgm", "map.yaml", "map.npz"}
SCAN = Scan(0, 0.0, 0.1, 0.0, 8.0, np.full(3, 2.0, np.float32))


@pytest.fixture
def judges(monkeypatch):
    """`judges(judge)` lets `judge` stand in for `Consistency.add`, but for the map of the warm-up."""
    add = Consistency.add

    def judges(judge):
        def judge_or_add(*args):
            return (add if threading.current_thread().name == "ogm-warm-up" else judge)(*args)

        monkeypatch.setattr(Consistency, "add", judge_or_add)

    return judges


@pytest.fixture
def run(monkeypatch, tmp_path, judges):
    """`run(judge)` runs a mapper that gets one scan and is interrupted; the folder that it leaves.

    `judge` stands in for `Consistency.add` once it is ready.
    """

    def run(judge):
        def interrupted(service):
            service.live_map.integrate(SCAN, Pose(0.25, 0.25, 0.0))
            judges(judge)
            raise KeyboardInterrupt

        monkeypatch.setattr(MapperService, "wait", interrupted)
        settings = {"network": {"listen": ["tcp/127.0.0.1:0"]}, "http": {"port": 0}}
        with pytest.raises(KeyboardInterrupt):
            run_mapper(Settings.model_validate(settings), tmp_path)
        return tmp_path

    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    return run


def names(folder):
    return {path.name for path in folder.iterdir()}


def for_ever(_, placed, between):
    """Judge a scan that takes very long."""
    while True:
        between()
        time.sleep(0.001)


def test_the_map_is_there_before_its_figures_are_looked_for(run, tmp_path, caplog):
    (tmp_path / "quality.json").write_text("of another map")
    add, seen = Consistency.add, []

    def look(consistency, placed, between):
        seen.append(names(tmp_path))
        add(consistency, placed, between)

    folder = run(look)
    assert seen == [MAP]
    quality = json.loads((folder / "quality.json").read_text())
    assert (quality["scans"], quality["consistency"]["hits"]) == (1, 1.0)
    assert "missing" not in quality
    assert caplog.messages == []


def test_figures_that_take_too_long_are_left_out_and_it_is_said(run, monkeypatch, caplog):
    assert FIGURES_TIME == 5.0
    monkeypatch.setattr(last_map, "FIGURES_TIME", 0.2)
    folder = run(for_ever)
    assert names(folder) == {*MAP, "quality.json"}
    quality = json.loads((folder / "quality.json").read_text())
    assert quality["missing"] == ["consistency"]
    assert quality["consistency"] == {"hits": None, "free": None}
    assert (quality["scans"], quality["known_m2"] > 0.0, quality["truth"]) == (1, True, None)
    assert caplog.messages == [
        f"{folder}: figures that take longer than 0.2 s are left out of quality.json: consistency"
    ]


def test_who_has_asked_for_figures_does_not_hold_up_the_end(start_mapper, judges, in_background):
    begun = threading.Event()

    def slow(consistency, placed, between):
        begun.set()
        for_ever(consistency, placed, between)

    with start_mapper() as mapper:
        mapper.draw_cross()
        judges(slow)
        over_http = in_background(mapper.http.get, "/quality")
        over_zenoh = in_background(mapper.ask, "quality")
        assert begun.wait(10.0)
        started = time.monotonic()
        mapper.service.__exit__(None, None, None)
        assert time.monotonic() - started < 4.0
        assert over_http.result(5.0).status_code == 503
        assert over_http.result(5.0).json()["type"] == "unavailable"
        (reply,) = over_zenoh.result(5.0)
        assert json.loads(reply.err.payload.to_bytes())["type"] == "unavailable"


def test_a_disk_that_is_full_at_the_end_leaves_the_older_map(run, tmp_path, disk_full):
    for name in (*MAP, "quality.json"):
        (tmp_path / name).write_bytes(b"before")
    with pytest.raises(DiskFull, match="No space left on device"):
        run(Consistency.add)
    assert all((tmp_path / name).read_bytes() == b"before" for name in (*MAP, "quality.json"))
    assert names(tmp_path) == {*MAP, "quality.json"}
