"""`mapper.threads`: how many, where they are used, that the map is the same, and that they end."""

import math
import os
import threading

import numpy as np
import pytest

from ogm_core.files.map_files import read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.logs.jsonl_writer import write_jsonl
from ogm_core.logs.recordings import RecordedScan
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.types import Pose, Scan
from ogm_services.commands.build import run_build
from ogm_services.commands.build_request import BuildRequest
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.settings.sources import load_settings

BEAMS = 1400
FINE = 0.02
"""m: a scan of so many beams of some metres changes 400,000 cells."""


def settings_of(threads=None, **environ):
    flags = {} if threads is None else {"mapper": {"threads": threads}}
    return load_settings(config=None, flags={"map": {"resolution": str(FINE)}, **flags}, environ=environ)


def ranges(k):
    return (6.0 + 1.5 * np.sin(np.arange(BEAMS) / 40.0 + k)).astype(np.float32)


def scan(k, pose=None):
    return Scan(k, -math.pi, math.tau / BEAMS, 0.0, 8.0, ranges(k), pose=pose, seq=k)


def update_threads_alive():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("ogm-update-")]


@pytest.mark.parametrize(
    ("given", "threads", "count"), [(None, 1, 1), ("3", 3, 3), ("auto", "auto", 3), ("AUTO", "auto", 3)]
)
def test_so_many_threads(given, threads, count, monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 2, 5, 7})
    mapper = settings_of(given).mapper
    assert (mapper.threads, mapper.thread_count) == (threads, count)


def test_on_one_core_auto_is_one_thread(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3})
    assert settings_of(OGM_MAPPER__THREADS="auto").mapper.thread_count == 1


def test_a_map_that_takes_the_place_of_another_has_its_threads():
    settings = GridSettings(resolution=FINE)
    one, other = OccupancyGrid(settings, "a"), OccupancyGrid(settings, "b")
    with UpdateThreads(2) as shared:
        live = LiveMap(one, threads=shared)
        live.become(other)
        live.integrate(scan(0), Pose(0.0, 0.0, 0.0))
        assert other.threads is shared
        assert update_threads_alive() == ["ogm-update-1"]
    assert not update_threads_alive()


def test_a_mapper_with_threads_makes_the_map_of_one(start_mapper, no_errors, eventually):
    grid = OccupancyGrid(GridSettings(resolution=FINE))
    poses = [Pose(0.1 * k, -0.05 * k, 0.2 * k) for k in range(6)]
    with start_mapper(map={"resolution": FINE}, mapper={"threads": 3}) as mapper:
        for k, pose in enumerate(poses):
            shape = {"angle_min": -math.pi, "angle_increment": math.tau / BEAMS}
            mapper.scan(ranges(k), pose=list(pose), at=k, seq=k, **shape)
            grid.integrate(scan(k), pose)
        status = mapper.settle(received=len(poses))
        assert (status["threads"], status["revision"]) == (3, len(poses))
        # The rest of the warm-up has some of its own, for a moment or for as long as kernels compile.
        eventually(lambda: update_threads_alive() == ["ogm-update-1", "ogm-update-2"])
        served = read_npz(mapper.http.get("/map.npz").content)
    assert not update_threads_alive()
    snapshot = grid.snapshot()
    assert np.array_equal(served.log_odds, snapshot.model.arrays(snapshot.stored)["log_odds"], equal_nan=True)


def test_a_build_with_threads_makes_the_files_of_one(tmp_path, monkeypatch):
    log = tmp_path / "log.jsonl"
    scans = [RecordedScan("r", "s", scan(k, Pose(0.1 * k, 0.0, 0.3 * k))) for k in range(8)]
    write_jsonl(log, scans)
    used, start = [], threading.Thread.start

    def started(thread):
        used.append(thread.name)
        start(thread)

    monkeypatch.setattr(threading.Thread, "start", started)
    for threads in ("1", "3"):
        run_build(BuildRequest([log], tmp_path / threads, settings_of(threads)))
    assert [name for name in used if name.startswith("ogm-update")] == ["ogm-update-1", "ogm-update-2"]
    assert not update_threads_alive()
    for file in ("map.npz", "map.png", "map.pgm", "map.yaml", "quality.json"):
        assert (tmp_path / "3" / file).read_bytes() == (tmp_path / "1" / file).read_bytes()
