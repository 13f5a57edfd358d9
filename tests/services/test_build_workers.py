"""`ogm build --workers`: the files are those of one process, byte for byte, whatever the limits."""

import json
import multiprocessing
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest

from full_disk import room_for
from ogm_core.errors import BadRecording, DiskFull, LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import CellRect, Clip
from ogm_core.logs.recordings import RecordedScan, RecordingReader, write_jsonl
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_services.commands import build
from ogm_services.commands.batch.areas import areas_of
from ogm_services.commands.batch.mapping import accepted_by
from ogm_services.commands.batch.placed_scans import PlacedLog, ScanFiles
from ogm_services.commands.batch.tasks import run_task
from ogm_services.commands.build import run_build
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.settings.sources import load_settings
from rough_log import write_three_logs

FILES = ("map.npz", "map.png", "map.pgm", "map.yaml", "quality.json", "logs.json")
FLAGS = {
    "int16": {},
    "float64, dda": {"cells": "float64", "traversal": "dda"},
    "sector": {"sensor_model": "sector"},
    "half-life": {"half_life": 2.0},
    "rate": {"cell_model": "rate"},
    "bounds": {"bounds": "-9,-10,9,10", "outside": "drop"},
    "bounds, clipped": {"bounds": "-9,-10,9,10", "cell_model": "rate"},
}


class InThisProcess:
    """Workers that are none: tasks are run here, the last one first, and twice, as if workers had died."""

    elsewhere = False

    def __init__(self, count):
        self.count = count

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def run(self, _, tasks):
        for task in tasks:
            run_task(task)
        return [run_task(task) for task in reversed(tasks)][::-1]


@pytest.fixture
def logs(tmp_path):
    return write_three_logs(tmp_path)


@pytest.fixture
def at_work(monkeypatch):
    monkeypatch.setattr(build, "WorkerProcesses", InThisProcess)


def settings_of(mapper=None, **flags):
    return load_settings(config=None, flags={"map": flags, "mapper": mapper or {}}, environ={})


def files_of(folder):
    assert {path.name for path in folder.iterdir()} == {*FILES, "map.svg"}
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def built(out, paths, settings, **options):
    run_build(BuildRequest(paths, out, settings, world="lab", figure=out / "map.svg", **options))
    return files_of(out)


@pytest.mark.usefixtures("at_work")
@pytest.mark.parametrize("flags", FLAGS)
def test_the_files_are_those_of_one_process(tmp_path, logs, flags, capsys):
    """Of three logs, with scans held out, judged by the truth and drawn."""
    settings, held = settings_of(**FLAGS[flags]), HeldScans(7)
    alone = built(tmp_path / "alone", logs, settings, held=held)
    said = capsys.readouterr().out.replace("alone", "many")
    assert built(tmp_path / "many", logs, settings, held=held, workers=4) == alone
    assert capsys.readouterr().out == said
    assert not list(tmp_path.glob(".ogm-build-*"))


@pytest.mark.usefixtures("at_work")
def test_a_map_that_forgets_does_so_wherever_its_scans_lie(tmp_path, logs):
    """Three logs far from each other: time passes in an area by scans of others, to the last one."""
    for log, by in ((logs[1], 40.0), (logs[2], -40.0)):
        with RecordingReader(log) as reader:
            messages = list(reader)
        write_jsonl(log, [shifted(message, by) for message in messages])
    settings = settings_of(half_life=1.0)
    assert built(tmp_path / "many", logs, settings, workers=4) == built(tmp_path / "alone", logs, settings)


def shifted(message, by):
    """A message of 10 s later; a pose lies so many metres farther in the east."""
    told = replace(message.message, stamp=message.message.stamp + 10 * 10**9)
    if not isinstance(message, RecordedScan):
        told = replace(told, pose=told.pose._replace(x=told.pose.x + by))
    return replace(message, message=told)


def test_processes_make_the_same_files(tmp_path, logs):
    alone = built(tmp_path / "alone", logs, settings_of())
    assert built(tmp_path / "many", logs, settings_of(), workers=2) == alone
    assert not multiprocessing.active_children()


@pytest.mark.usefixtures("at_work")
def test_scans_that_would_stretch_the_map_too_far_are_refused_as_one_process_does(tmp_path, logs, capsys):
    whole = {"mapper": {"max_cells": 100_000}}
    alone = built(tmp_path / "alone", logs, settings_of(**whole))
    capsys.readouterr()
    assert built(tmp_path / "many", logs, settings_of(**whole), workers=3) == alone
    dropped = [one["dropped"].get("limit", 0) for one in json.loads(alone["logs.json"]).values()]
    assert max(dropped) > 5
    assert min(one["integrated"] for one in json.loads(alone["logs.json"]).values()) > 5
    first = next(number for number, count in enumerate(dropped) if count)
    assert (
        f"{logs[first]}: {dropped[first]} scans are dropped (limit): the map would be"
        in capsys.readouterr().err
    )


@pytest.mark.usefixtures("at_work")
@pytest.mark.parametrize("share", [0.5, 0.999])
def test_a_map_that_has_no_room_is_refused_with_what_to_do(tmp_path, logs, share):
    """In one area, or in none of them but in all together; one process leaves scans out and counts them."""
    grid = OccupancyGrid(settings_of().grid_settings())
    run_build(BuildRequest(logs, tmp_path / "alone", settings_of()))
    written = json.loads((tmp_path / "alone/quality.json").read_text())["known_m2"] / 0.05**2 / 64**2
    room = int(share * written * grid._store.tile_bytes)
    settings = settings_of({"max_bytes": max(room, 2**20)})
    with pytest.raises(
        LimitReached, match=r"mapper\.max_bytes = .*raise it, .*or leave --workers and --dask out"
    ):
        run_build(BuildRequest(logs, tmp_path / "many", settings, workers=2))
    assert not (tmp_path / "many").exists()


@pytest.mark.usefixtures("at_work")
def test_a_log_that_cannot_be_read_is_refused_and_nothing_is_written(tmp_path, logs):
    (tmp_path / "empty.jsonl").write_text("")
    with pytest.raises(BadRecording, match=r"empty\.jsonl: .*holds no scan"):
        run_build(BuildRequest([*logs, tmp_path / "empty.jsonl"], tmp_path / "out", settings_of(), workers=2))
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [*(log.name for log in logs), "empty.jsonl"]
    )


class FullDiskAfter(InThisProcess):
    """The disk has no room from the end of one stage on."""

    def __init__(self, stage, stack, size):
        super().__init__(2)
        self.stage, self.stack, self.size = stage, stack, size

    def run(self, text, tasks):
        results = super().run(text, tasks)
        if text == self.stage:
            self.stack.enter_context(room_for(self.size))
        return results


@pytest.mark.parametrize("stage", ["placing logs", "mapping areas"])
@pytest.mark.parametrize("size", [0, 200])
def test_a_disk_that_is_full_between_stages_is_told_in_one_line(tmp_path, logs, monkeypatch, stage, size):
    """200 bytes hold the head of a file, and not what comes after it."""
    with ExitStack() as stack:
        monkeypatch.setattr(build, "WorkerProcesses", lambda _: FullDiskAfter(stage, stack, size))
        with pytest.raises(DiskFull, match=r"--out \S+: cannot be written: File too large$"):
            run_build(BuildRequest(logs, tmp_path / "out", settings_of(), workers=2))
    assert sorted(tmp_path.iterdir()) == sorted(logs)


def test_areas_fill_the_plane_and_share_the_work():
    """Of scans that lie along a bent way, most of them in a corner."""
    rng = np.random.default_rng(3)
    corner = np.concatenate([rng.integers(-5000, 9000, (300, 2)), rng.integers(0, 400, (500, 2))])
    extents = np.concatenate([corner, rng.integers(50, 500, (800, 2))], axis=1)
    costs = rng.uniform(1.0, 5.0, 800)
    for count in (1, 2, 3, 4, 7):
        areas = areas_of(extents, costs, count)
        assert len(areas) == count
        points = rng.integers(-9000, 9000, (300, 2))
        for x, y in points.tolist():
            assert sum(area.rect.contains(CellRect(x, y, 1, 1)) for area in areas) == 1
        shares = [shared(extents, costs, area) / costs.sum() for area in areas]
        assert sum(shares) == pytest.approx(1.0)
        assert max(shares) < 1.25 / count


def shared(extents, costs, area):
    """How much of the costs lies in an area, if that of each rectangle lies evenly in it."""
    inside = [CellRect(*row).intersection(area.rect).cells / (row[2] * row[3]) for row in extents.tolist()]
    return float(np.dot(inside, costs))


def test_what_cannot_be_cut_is_one_area():
    here = np.array([[3, 5, 20, 30], [40, 2, 10, 60]])
    assert areas_of(here, np.ones(2), 4) == [Clip()]
    assert areas_of(np.empty((0, 4), np.int64), np.empty(0), 4) == [Clip()]
    beside = areas_of(np.array([[3, 5, 120, 30]]), np.ones(1), 4)
    assert beside == [Clip(xmax=64), Clip(xmin=64)]


def test_a_scan_is_accepted_unless_it_stretches_the_map_too_far_with_those_before():
    settings = settings_of({"max_cells": 1000}).grid_settings()
    rows = np.array(
        [[0, 0, 10, 10], [90, 0, 10, 10], [0, 90, 10, 1], [0, 0, 0, 0], [50, 0, 5, 10], [0, 0, 101, 1]]
    )
    accepted, known = accepted_by(settings, rows, None)
    assert accepted.tolist() == [True, True, False, True, True, False]
    assert known == CellRect(0, 0, 100, 10)
    assert accepted_by(settings, rows[2:3], known)[0].tolist() == [False]


@pytest.mark.parametrize(
    "array",
    [
        np.arange(12, dtype=np.int16).reshape(3, 4),
        np.arange(12.0).reshape(3, 4).T,
        np.zeros((0, 4096), np.int8),
        np.arange(10)[::3],
    ],
    ids=["int16", "by columns", "empty", "every third"],
)
def test_a_large_array_comes_back_as_it_was(tmp_path, array):
    files = ScanFiles(tmp_path)
    files.write_large("array", array)
    read = files.large("array")
    assert (read.dtype, read.shape) == (array.dtype, array.shape)
    np.testing.assert_array_equal(read, array)


def test_placed_scans_come_back_as_they_were(tmp_path):
    ranges = np.array([1.0, np.inf, np.nan, 2.5], np.float32)
    pose = Pose(1.0, 2.0, 3.0)
    scan = Scan(7, -1.0, 0.5, 0.1, 8.0, ranges, 0.001, Pose(0.1, 0.0, 0.0), pose, 5, "run", reach=4.0)
    sweep = Sweep(pose, np.arange(12.0).reshape(4, 3))
    files = ScanFiles(tmp_path)
    part = files.new()
    with part.open("wb") as file:
        placed = PlacedLog(file)
        for number in range(3):
            one = PlacedScan(scan, pose, sweep if number else None)
            placed.add(one, CellRect(number, 2, 3, 4), 10.0, f"r{number % 2}", (0.5, number))
        placed.held.append(PlacedScan(scan, pose))
    files.write_log(4, part, placed)
    index = files.index_of(4)
    (one, first), (other, third) = files.scans(4, index, np.array([True, False, True]))
    assert (one, other, first.sweep) == (0, 2, None)
    assert third.sweep.beams.tolist() == sweep.beams.tolist()
    assert third.scan.ranges.tobytes() == ranges.tobytes()
    assert (third.scan.stamp, third.scan.reach, third.pose) == (7, 4.0, pose)
    assert index.extents.tolist() == [[0, 2, 3, 4], [1, 2, 3, 4], [2, 2, 3, 4]]
    assert (index.robots.tolist(), placed.robots, index.stamps.tolist()) == ([0, 1, 0], ["r0", "r1"], [7] * 3)
    assert len(files.held(4)) == 1
