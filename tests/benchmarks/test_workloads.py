"""What the benchmarks measure on, and that their textbook makes the map that ours is compared with."""

import math
import os
import shutil

import numpy as np
import pytest

from benchmarks.agreement import different_cells, log_odds_in, same_class
from benchmarks.contenders import Ours, interleaved
from benchmarks.limit import Limit
from benchmarks.peers.process import NoPeer, Peer, build
from benchmarks.peers.workload_file import read_map, write_workload
from benchmarks.workloads import big, first_scans, lab_exercise, settings_of
from ogm_core.errors import BadParameter
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import CellRect


@pytest.fixture(scope="module")
def big_work():
    return big(60)


@pytest.fixture(scope="module")
def textbook(tmp_path_factory):
    if shutil.which("g++") is None:
        pytest.skip("g++ is not installed: it builds the textbook's program")
    return build("textbook", tmp_path_factory.mktemp("peers"))


def mapped(work, **settings):
    ours = Ours("ours", work, settings_of(work, **settings))
    ours.round()
    return ours.grid


class TestWorkloads:
    @pytest.mark.parametrize("make", [lab_exercise, lambda: big(5)])
    def test_the_same_twice(self, make):
        first, again = make(), make()
        assert len(first.scans) == len(again.scans)
        for one, other in zip(first.scans, again.scans, strict=True):
            assert one.pose == other.pose
            assert one.scan.ranges.tobytes() == other.scan.ranges.tobytes()

    def test_another_seed_is_another_world(self):
        assert big(1, seed=1).scans[0].scan.ranges.tobytes() != big(1, seed=2).scans[0].scan.ranges.tobytes()

    def test_fewer_scans_are_the_first_of_more(self, big_work):
        few = big(3)
        assert few.scans[2].scan.ranges.tobytes() == big_work.scans[2].scan.ranges.tobytes()
        assert [placed.pose for placed in first_scans(big_work, 3).scans] == [p.pose for p in few.scans]

    def test_the_lab_is_the_textbook_exercise(self):
        work = lab_exercise()
        assert len(work.scans) == 220
        assert {placed.scan.ranges.size for placed in work.scans} == {360}
        assert [math.hypot(*placed.pose[:2]) for placed in work.scans] == pytest.approx([6.0] * 220)
        assert max(placed.scan.ranges.max() for placed in work.scans) == 8.0

    def test_the_big_world_is_as_described(self):
        work = big()
        ranges = np.stack([placed.scan.ranges for placed in work.scans])
        assert ranges.shape == (1000, 1081)
        assert ranges.mean() == pytest.approx(15.5, abs=0.2)
        assert np.mean(ranges < 30.0 - work.alpha / 2) == pytest.approx(0.81, abs=0.01)
        way = np.array([placed.pose[:2] for placed in work.scans])
        steps = np.hypot(*np.diff(way, axis=0, append=way[:1]).T)
        assert steps.sum() == pytest.approx(1163.0, rel=0.01)
        assert steps.max() < 1.3


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system ties no process to a core")
def test_contenders_share_a_core_in_every_round():
    rounds = []

    class Contender:
        name, pid = "somebody", 0

        def round(self):
            rounds.append(os.sched_getaffinity(0))
            return np.ones(1)

    before = os.sched_getaffinity(0)
    interleaved([Contender(), Contender()], 2 * len(before))
    assert rounds == [{core} for core in sorted(before) for _ in range(2)] * 2
    assert os.sched_getaffinity(0) == before


class TestTextbook:
    @pytest.mark.parametrize("name", ["lab", "big"])
    def test_makes_our_float64_map_bit_for_bit(self, name, textbook, big_work, tmp_path):
        work = lab_exercise() if name == "lab" else big_work
        rect = write_workload(work, tmp_path / "workload")
        grid = mapped(work, cells="float64")
        with Peer(textbook, tmp_path / "workload") as peer:
            times = peer.round()
            assert times.size == len(work.scans)
            assert peer.updates == grid.cell_updates > 1000 * len(work.scans)
            peer.dump(tmp_path / "map")
        their_rect, theirs = read_map(tmp_path / "map")
        assert their_rect == rect
        np.testing.assert_array_equal(theirs, log_odds_in(rect, grid))

    def test_a_second_round_begins_afresh(self, textbook, tmp_path):
        work = first_scans(lab_exercise(), 10)
        write_workload(work, tmp_path / "workload")
        grid = mapped(work, cells="float64")
        with Peer(textbook, tmp_path / "workload") as peer:
            interleaved([peer], rounds=2)
            assert different_cells(peer, grid, tmp_path) == 0

    def test_another_map_is_told_from_it(self, textbook, tmp_path):
        work = first_scans(lab_exercise(), 10)
        write_workload(work, tmp_path / "workload")
        with Peer(textbook, tmp_path / "workload") as peer:
            peer.round()
            assert different_cells(peer, mapped(work, cells="float64", traversal="dda"), tmp_path) > 100
            peer.round()
            assert 0.9 < same_class(peer, mapped(work, cells="float64", traversal="dda"), tmp_path) < 1.0

    def test_a_program_that_ends_early_is_told(self, textbook, tmp_path):
        (tmp_path / "workload").write_bytes(b"short")
        with pytest.raises(NoPeer, match="textbook: it ended with code 1"):
            Peer(textbook, tmp_path / "workload")


def test_a_peer_without_a_compiler_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(NoPeer, match=r"mrpt: there is no g\+\+"):
        build("mrpt", tmp_path)


def test_scans_of_two_kinds_are_refused(big_work, tmp_path):
    mixed = first_scans(big_work, 2)
    mixed.scans[1] = lab_exercise().scans[0]
    with pytest.raises(BadParameter, match="differ"):
        write_workload(mixed, tmp_path / "workload")


def test_an_unbounded_workload_lies_in_its_rectangle(big_work, tmp_path):
    rect = write_workload(big_work, tmp_path / "workload")
    assert rect.contains(mapped(big_work).rect)
    assert write_workload(lab_exercise(), tmp_path / "workload") == CellRect(0, 0, 200, 200)


def test_the_least_work_covers_every_cell_that_a_scan_sees(big_work):
    limit = Limit(big_work, every=30)
    assert limit.round().size == 2
    for n in (0, 1):
        placed = big_work.scans[30 * n]
        seen = OccupancyGrid(settings_of(big_work, sensor_model="sector"))
        seen.integrate(*placed)
        row, first, end = limit.spans_of(placed)
        assert row.size == limit.blocks[n].shape[1]
        assert np.all(first < end)
        assert (end - first).sum() == seen.cell_updates
