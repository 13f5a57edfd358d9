"""Benchmarks of the services: what they do to the numbers they measure, and what they measure on."""

import http.server
import math
import threading

import numpy as np
import pytest

from benchmarks import http_clients
from benchmarks.__main__ import BENCHMARKS, benchmark
from benchmarks.corridors import BLOCKS, SPACING, WIDTH, closed_corridor, corridors
from benchmarks.latency import as_results, latencies, percentile
from benchmarks.pictures import NEAR, picture_of, pillow, short_sighted
from benchmarks.robots import DRIFT, RATE, ROBOTS, timetable
from benchmarks.running import line_after, map_scans, mapper, program
from benchmarks.throughput import encoded, handled
from benchmarks.tiles import _mapped_and_looked_at, _mapped_and_told, told, upkeep
from benchmarks.workloads import big, lab_exercise, mapped
from ogm_client import MapClient
from ogm_core.files.map_files import encode_png
from ogm_core.wire.messages import decode_scan


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_is_there(name):
    assert callable(benchmark(name))


class TestLatencies:
    def test_a_scan_is_seen_by_the_first_answer_that_counts_it(self):
        put = np.array([10, 20, 30, 40]) * 1_000_000
        seen = np.array([0, 21, 35, 90]) * 1_000_000
        counts = np.array([0, 1, 3, 4])
        assert latencies(put, seen, counts).tolist() == [11.0, 15.0, 5.0, 50.0]

    def test_scans_that_no_answer_counts_are_lost(self):
        put = np.array([1, 2, 3]) * 1_000_000
        ms = latencies(put, np.array([0, 5_000_000]), np.array([0, 2]))
        assert ms.tolist() == [4.0, 3.0, math.inf]
        results = {result.name: result for result in as_results("g", ms, {50: 4.0, 99: 9.0})}
        assert (results["p50"].value, results["p50"].met) == (4.0, True)
        assert (results["p99"].value, results["p99"].met) == (math.inf, False)
        assert (results["scans lost, of 3"].value, results["scans lost, of 3"].met) == (1, False)

    @pytest.mark.parametrize(
        ("share", "value"), [(1, 1.0), (50, 50.0), (99, 99.0), (99.5, 100.0), (100, 100.0)]
    )
    def test_a_percentile_is_one_of_the_values(self, share, value):
        values = np.random.default_rng(1).permutation(np.arange(1.0, 101.0))
        assert percentile(values, share) == value


def test_the_timetable_has_every_robots_scans_in_order():
    due = timetable(2.0)
    times = [at for at, _ in due]
    assert times == sorted(times)
    assert times[-1] < 2.0
    for robot in range(ROBOTS):
        own = [at for at, k in due if k == robot]
        assert own[0] == robot / (ROBOTS * RATE)
        np.testing.assert_allclose(np.diff(own), (1.0 + DRIFT * robot) / RATE)
        assert len(own) == 80


class TestCorridors:
    def test_the_same_twice(self):
        first, again = corridors(), corridors()
        assert [placed.pose for placed in first.scans] == [placed.pose for placed in again.scans]
        for one, other in zip(first.scans, again.scans, strict=True):
            assert one.scan.ranges.tobytes() == other.scan.ranges.tobytes()

    @pytest.mark.parametrize("seed", range(5))
    def test_the_way_is_closed_and_meets_every_crossing_once(self, seed):
        way = closed_corridor(np.random.default_rng(seed))
        assert len(way) == len(set(way)) == 4 * BLOCKS**2
        steps = np.diff(np.array([*way, way[0]]), axis=0)
        assert np.abs(steps).sum(axis=1).tolist() == [1] * len(way)

    def test_another_seed_is_another_way(self):
        assert closed_corridor(np.random.default_rng(1)) != closed_corridor(np.random.default_rng(2))

    def test_no_beam_leaves_the_corridor(self):
        work = corridors()
        known = mapped(work).snapshot().known_cells * work.resolution**2
        inside = 4 * BLOCKS**2 * SPACING * WIDTH
        assert inside < known < 1.06 * inside  # and the cells of the walls


class TestPictures:
    def test_pillow_encodes_the_same_picture(self):
        grid = mapped(lab_exercise())
        grey = picture_of(grid, "ros")
        assert grey.shape == (200, 200)
        assert set(np.unique(grey)) == {0, 205, 254}
        assert pillow(grey)[:8] == encode_png(grid.snapshot())[:8]

    def test_a_short_sighted_scan_ends_where_it_sees_nothing(self):
        placed = big(1).scans[0]
        near = short_sighted(placed)
        assert (near.pose, near.scan.range_max) == (placed.pose, NEAR)
        seen = placed.scan.ranges < NEAR
        assert np.array_equal(near.scan.ranges[seen], placed.scan.ranges[seen])
        assert set(near.scan.ranges[~seen].tolist()) == {NEAR}


def test_overviews_are_kept_up_to_date_of_every_tile_that_was_written():
    work = big(3)
    share, both, of_a_tile, memory = upkeep(work, 1)
    assert 0.0 < share.value < both.value
    assert (share.at_least, memory.value) == (False, (64 * 64 - 1) / 3)
    assert of_a_tile.value > 0.0
    made = _mapped_and_looked_at(work)[-1]
    assert made == np.count_nonzero(mapped(work).snapshot().stored.tiles.numbers)


def test_followers_are_told_of_every_tile_that_was_written():
    work = big(3)
    share, both, of_a_tile, size = told(work, 1)
    assert 0.0 < share.value < both.value
    assert (share.at_least, of_a_tile.value > 0.0, 16.0 < size.value < 8192.0) == (False, True, True)
    tiles = _mapped_and_told(work)[-2]
    assert tiles == np.count_nonzero(mapped(work).snapshot().stored.tiles.numbers)


def test_messages_go_round_the_lap_and_count_on():
    work = big(3)
    scans = [decode_scan(payload) for payload in encoded(work, 7, "run1")]
    assert [(scan.run, scan.seq) for scan in scans] == [("run1", seq) for seq in range(7)]
    assert [scan.ranges.tobytes() for scan in scans[3:6]] == [
        placed.scan.ranges.tobytes() for placed in work.scans
    ]


def test_a_mapper_is_filled_and_followed():
    work = lab_exercise()
    with mapper("--preset", "lab") as running, MapClient(running.endpoint) as client:
        assert handled(client, "any") == 0
        map_scans(running, work.scans)
        (robot,) = client.status().robots.values()
        assert handled(client, robot.sources["laser"].run) == len(work.scans)
        assert client.status().scans.integrated == len(work.scans)


def test_a_program_that_ends_without_its_line_is_told():
    with program(["echo", "something else"]) as process, pytest.raises(RuntimeError, match="live map"):
        line_after(process, "live map ")


@pytest.mark.parametrize("installed", [True, False])
def test_clients_count_their_answers(installed, monkeypatch):
    if installed and not http_clients.have_wrk():
        pytest.skip("wrk is not installed")
    monkeypatch.setattr(http_clients, "have_wrk", lambda: installed)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Always200) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            url = f"http://127.0.0.1:{server.server_address[1]}/map.png"
            with http_clients.clients(url, 2, 1.0) as load:
                assert http_clients.rate_of(load, 1.0) > 0
        finally:
            server.shutdown()
            thread.join()


class _Always200(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self):
        self.send_response(200)
        self.send_header("Content-Length", "2")
        self.end_headers()
        self.wfile.write(b"ok")

    def log_message(self, *_):
        pass
