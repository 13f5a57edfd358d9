"""What robots make a mapper hold is bounded: by max_memory in all, and scans that wait by their share."""

from pathlib import Path

import numpy as np
import pytest

from mapper_desk import Desk
from ogm_core.cells.rate import Rate
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.placing.receipts import Receipts
from ogm_core.placing.waiting import WaitingLimits
from ogm_core.sensor_models.scan_size import ScanSize
from ogm_core.separate_grid import SeparateGrid
from ogm_core.types import Pose, Scan
from ogm_core.units import MEBIBYTE
from ogm_services.mapper.live import map_memory
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving.answer_cache import CACHE_BYTES
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.answers import Answers
from ogm_services.runtime.memory import MemoryUse

TILE = 64 * 64 * 2
"""Bytes of a tile of int16 cells."""
HERE = Pose(0.25, 0.25, 0.0)
SETTINGS = GridSettings(resolution=0.5, max_cells=10**12)


def beam(x=0.25, length=2.0, beams=1):
    """A scan to the east of (x, 0), and its pose: 32 m of it write a tile."""
    return Scan(0, 0.0, 1e-9, 0.0, 100.0, np.full(beams, length, np.float32)), Pose(x, 0.25, 0.0)


def grown(live, until=10_000):
    """Drive east, a tile a scan, till the map gets no more; how many scans were taken."""
    for k in range(until):
        try:
            live.integrate(*beam(32.0 * k + 0.25, 30.0))
        except LimitReached as refusal:
            return k, refusal
    raise AssertionError("the map grows for ever")


def test_the_map_grows_until_it_and_its_copy_and_all_else_take_max_memory():
    memory, others = MemoryUse(4 * MEBIBYTE), [0]
    memory.add("queue", lambda: others[0], 100)
    live = LiveMap(OccupancyGrid(SETTINGS, "e"), memory)
    others[0] = MEBIBYTE
    taken, refusal = grown(live)
    map_bytes = memory.held()["map"]
    most = 3 * MEBIBYTE * 4 / 9  # a copy for readers takes up to a quarter more than the map
    assert map_bytes <= most < map_bytes + 3 * TILE + 40_000  # tables grow with the map
    assert (refusal.slug, refusal.kind) == ("limit", "max_memory")
    assert str(refusal).startswith(
        "it needs new tiles, and of mapper.max_memory, 4194304 bytes, too little is left "
        "(map 1 MiB, queue 1 MiB"
    )
    revision = live.now.revision
    assert revision == taken
    assert live.snapshot().known_cells > 50 * taken
    assert memory.total() <= memory.limit
    live.integrate(*beam(40.25, 20.0))  # within tiles that are there
    assert live.now.revision == revision + 1
    others[0] = 0
    assert grown(live, 10_000)[0] > taken
    live.snapshot()
    assert memory.total() <= memory.limit


def test_robots_that_are_kept_apart_count_with_their_sum_and_with_copies_for_the_store():
    settings = GridSettings(0.5, Rate(), max_cells=10**12, separate_robots=True)
    memory, tile = MemoryUse(32 * MEBIBYTE), 38 * 64 * 64
    live = LiveMap(SeparateGrid(settings, "e"), memory)

    def drive_side_by_side():
        for k in range(1000):
            scan, pose = beam(32.0 * (k // 2) + 0.25, 30.0)
            live.integrate(scan, pose, None, f"r{k % 2}")

    with pytest.raises(LimitReached, match=r"mapper\.max_memory, 33554432 bytes, too little is left"):
        drive_side_by_side()
    held = memory.held()["map"]
    most = 32 * MEBIBYTE * 4 / 9
    assert most - 8 * tile < held <= most  # three tiles, two robots' and the sum's, lie in each place
    live.snapshot()
    alone = memory.held()["copies"]
    live.copy_ahead()
    live.checkpoint()
    assert memory.held()["copies"] > 2.5 * alone
    assert memory.total() <= memory.limit
    before = live.now.revision
    live.forget("r1")
    assert (live.now.revision, live.robots) == (before + 1, ("r0",))
    assert memory.held()["map"] < 0.75 * held


def test_what_others_hold_stops_only_what_needs_new_tiles(monkeypatch):
    monkeypatch.setattr(map_memory, "LOOK_PERIOD", 0.0)
    memory, others = MemoryUse(64 * MEBIBYTE), [0]
    memory.add("queue", lambda: others[0])
    live = LiveMap(OccupancyGrid(SETTINGS, "e"), memory)
    live.integrate(*beam())
    before = live.snapshot().known_cells
    others[0] = 200 * MEBIBYTE
    with pytest.raises(LimitReached, match=r"max_memory, 67108864 bytes.*\(queue 200 MiB, copies .*, map "):
        live.integrate(*beam(1000.0))
    live.integrate(*beam(length=3.0))
    assert live.snapshot().known_cells == before + 2
    others[0] = 0
    live.integrate(*beam(1000.0))


def test_answers_that_are_kept_never_stop_the_map():
    memory = MemoryUse(4 * MEBIBYTE)
    live = LiveMap(OccupancyGrid(SETTINGS, "e"), memory)
    answers = Answers("hall", live, Receipts(), Monitor(live), memory=AnswerMemory(memory))
    alone = grown(LiveMap(OccupancyGrid(SETTINGS, "e"), MemoryUse(4 * MEBIBYTE)))[0]
    for k in range(alone):
        live.integrate(*beam(32.0 * k + 0.25, 30.0))
        for n in range(1 if k < alone - 40 else 10):
            answers.map("json", {"region": f"0,0,{90_000 + n},100"})
        assert memory.total() <= memory.limit
    full = answers.memory.kept_bytes
    assert 0 < full <= memory.share(CACHE_BYTES)
    with pytest.raises(LimitReached):
        live.integrate(*beam(32.0 * alone + 0.25, 30.0))
    assert answers.memory.kept_bytes == full  # nothing is let go for a scan that is refused all the same


def test_no_cache_keeps_more_than_a_sixteenth_of_the_memory(start_mapper):
    with start_mapper(map={"resolution": 0.1}, mapper={"max_memory": 16 * MEBIBYTE}) as mapper:
        mapper.scan([40.0] * 60, pose=list(HERE), range_max=50.0)
        mapper.settle(received=1)
        body = mapper.http.get("/map.json").content
        assert len(body) > MEBIBYTE
        assert mapper.service.memory.held()["caches"] == 0
        small = mapper.http.get("/map.json?region=0,0,10,10").content
        assert 2 * len(small) < mapper.service.memory.held()["caches"] < MEBIBYTE


def test_a_map_at_max_bytes_is_said_to_be_at_max_bytes():
    settings = GridSettings(resolution=0.5, max_cells=10**12, max_bytes=10 * TILE)
    live = LiveMap(OccupancyGrid(settings, "e"), MemoryUse(64 * MEBIBYTE))
    assert f" for which mapper.max_bytes = {10 * TILE} has no room: raise it, " in str(grown(live)[1])


def test_recent_scans_hold_their_share_at_most():
    memory = MemoryUse(6 * 1024**3)
    live = LiveMap(OccupancyGrid(SETTINGS, "e"), memory)
    for _ in range(100):
        live.integrate(*beam(beams=200_000))
    assert 63 * MEBIBYTE < memory.held()["recent"] <= memory.limits()["recent"] == 64 * MEBIBYTE
    live.reset("f")
    assert memory.held()["recent"] == 0
    for _ in range(150):
        live.integrate(*beam())
    assert memory.held()["recent"] == 100 * (4 + 1024)


def test_the_robot_whose_waiting_scans_hold_the_most_loses_its_oldest():
    desk = Desk(limits=WaitingLimits(100_000))
    for k in range(10):
        desk.scan(k, robot="small", run="a", seq=k, beams=100)
    for k in range(40):
        desk.scan(k, robot="large", sensor=f"s{k % 8}", run="a", seq=k, beams=2000)
        assert desk.placer.waiting_bytes <= 100_000
    robots = desk.receipts.status().robots
    assert robots["small"].sources["s"].pending == 10
    assert desk.placer.waiting_bytes == 10 * (400 + 1024) + 9 * (8000 + 1024)
    assert desk.dropped == {"no_pose": 31}
    source, text = next((source, text) for source, kind, text in desk.complaints if kind == "no room")
    assert source == "large/s0"
    assert text.startswith(
        "a scan is dropped (no_pose): no pose has come for it yet, and scans that wait for poses hold their "
        "share of memory, 0.0954 MiB, those of this robot the most of it: "
    )
    desk.pose(0, robot="large", run="a").pose(100, robot="large", run="a")
    assert desk.order == list(range(31, 40))  # the oldest went, whichever sensor they were of
    assert desk.placer.waiting_bytes == 10 * (400 + 1024)
    desk.pose(0, robot="small", run="a").pose(100, robot="small", run="a")
    assert desk.placer.waiting_bytes == 0


def test_a_robot_whose_waiting_scans_would_take_long_all_at_once_loses_its_oldest():
    desk = Desk(limits=WaitingLimits(cells=10_000.0, cells_of=lambda scan: 100.0 * scan.ranges.size))
    for k in range(30):
        desk.scan(k, robot="small", run="a", seq=k, beams=1)
        desk.scan(k, robot="large", sensor=f"s{k % 3}", run="a", seq=k, beams=10)
    desk.scan(30, robot="alone", run="a", seq=0, beams=500)  # one may always wait
    robots = desk.receipts.status().robots
    assert robots["small"].sources["s"].pending == 30
    assert robots["alone"].sources["s"].pending == 1
    assert desk.dropped == {"no_pose": 20}
    text = next(text for _, kind, text in desk.complaints if kind == "too much waits")
    assert "scans of this robot that speak of 1e+04 cells wait already" in text
    desk.pose(0, robot="large", run="a").pose(100, robot="large", run="a")
    assert desk.order == list(range(20, 30))
    for k in range(30):  # what was placed makes room
        desk.scan(101 + k, robot="large", sensor=f"s{k % 3}", run="a", seq=30 + k, beams=10)
    sources = desk.receipts.status().robots["large"].sources.values()
    assert sum(source.pending for source in sources) == 10


@pytest.mark.parametrize("model", ["beam", "sector"])
def test_no_scan_speaks_of_more_cells_than_it_may(model):
    rng = np.random.default_rng(3)
    size = ScanSize(GridSettings(sensor_model=model, reach=12.0))
    for beams, increment in ((1, 1.0), (10, 0.7), (360, 0.0175), (1081, 0.0044)):
        ranges = rng.uniform(0.0, 30.0, beams).astype(np.float32)
        for known in (ranges, np.full(beams, np.inf, np.float32)):
            scan = Scan(0, -3.0, increment, 0.0, 20.0, known)
            assert size.of(scan) <= size.at_most(scan) * (1.0 + 1e-9)
    assert size.at_most(scan) == pytest.approx(
        1081 * 240 + (0 if model == "beam" else 1081 * 0.0044 * 240**2 / 2)
    )


def test_without_a_share_as_in_a_build_all_of_them_wait():
    desk = Desk()
    for k in range(50):
        desk.scan(k, run="a", seq=k, beams=200_000)
    assert (desk.pending, desk.placer.waiting_bytes) == (50, 50 * (800_000 + 1024))


def resident():
    """Memory of this process, bytes."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * 4096


def test_a_mapper_with_little_memory_bears_floods_and_answers(start_mapper, no_errors, caplog):
    with start_mapper(
        map={"resolution": 0.5}, mapper={"max_memory": 16 * MEBIBYTE, "pose_wait": 600}
    ) as mapper:
        memory = mapper.service.memory
        mapper.scan([5.0], pose=list(HERE))
        mapper.settle(received=1)
        before = resident()
        for k in range(500):  # 400 MB that wait for poses
            mapper.scan(np.ones(200_000, "<f4"), angle_increment=1e-5, at=k, run="a", seq=k)
            if k % 50 == 0:
                mapper.status()
        for k in range(900):  # 900 tiles and more of map
            mapper.scan([60.0] * 63, pose=[100.0 * k, 0.25, 0.0], range_max=100.0, robot="far")
        mapper.scan([6.0], pose=list(HERE))
        status = wait_for(mapper, lambda status: status["robots"]["r"]["sources"]["s"]["integrated"] == 2)
        dropped = status["scans"]["dropped"]
        assert dropped["no_pose"] + dropped["overload"] >= 498
        assert dropped["limit"] > 100
        assert memory.held()["waiting"] <= memory.limits()["waiting"] == MEBIBYTE
        assert memory.held()["queue"] <= memory.limits()["queue"] == MEBIBYTE
        metrics = mapper.http.get("/metrics").text
        assert 'ogm_memory_kind_limit_bytes{kind="queue",map="hall"} 1.048576e+06' in metrics
        assert mapper.http.get("/map.png").status_code == 200
        assert memory.total() <= memory.limit
        assert resident() < before + 150 * MEBIBYTE
    told = " ".join(record.getMessage() for record in caplog.records)
    assert "scans that wait for poses hold their share of memory, 1 MiB" in told
    assert "of mapper.max_memory, 16777216 bytes, too little is left (" in told


def wait_for(mapper, reached):
    for _ in range(10_000):
        status = mapper.status()
        if reached(status):
            return status
    raise AssertionError(status)
