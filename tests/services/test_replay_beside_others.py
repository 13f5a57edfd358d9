"""A replay judges the mapper by the log's own scans, whatever other robots do meanwhile."""

import hashlib
import re
import threading
import time
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ogm_client import MapClient, MapperError, NobodyAnswered, RobotPublisher
from ogm_core.logs.recordings import RecordedScan, write_jsonl
from ogm_core.placing import receipts
from ogm_core.status import SourceStatus
from ogm_core.types import IDENTITY, Pose, Scan
from ogm_core.wire.keys import Source
from ogm_services.commands import on_the_way, replay
from ogm_services.commands.on_the_way import OnTheWay, Size
from ogm_services.commands.replay import ReplayFailed, run_replay
from ogm_services.settings.settings import NetworkSettings, Settings


@contextmanager
def another_robot(mapper):
    """A robot that keeps the mapper busy."""
    stop = threading.Event()

    def publish():
        while not stop.wait(0.02):
            mapper.scan([1.0], robot="other", pose=[0.0, 0.0, 0.0])

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def log_of(path, count, *, beams, stamp=0):
    """A log of one robot's scans, each with its own pose."""
    ranges = np.ones(beams, np.float32)
    fields = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 8.0}
    scans = [Scan(stamp + k, ranges=ranges, pose=IDENTITY, **fields) for k in range(count)]
    write_jsonl(path, (RecordedScan("logged", "laser", scan) for scan in scans))
    return path


def replay_into(mapper, log):
    network = NetworkSettings(map_name=mapper.keys.map_name, connect=(mapper.endpoint,))
    run_replay(log, Settings(network=network), speed=None)


NONE_YET = SourceStatus(run="", last_seq=None, received=0, pending=0, integrated=0)


def answering(monkeypatch, change):
    """Have the mapper's status changed by `change`, which is told how often it was asked before."""
    ask, count = MapClient.status, [0]

    def status(client):
        count[0] += 1
        return change(count[0] - 1, ask(client))

    monkeypatch.setattr(replay.MapClient, "status", status)


@pytest.mark.parametrize(
    "error", [NobodyAnswered("away"), MapperError("starting", 503, "it starts")], ids=["away", "starts"]
)
def test_a_mapper_that_is_away_for_a_while_is_waited_for(mapper, tmp_path, monkeypatch, capsys, error):
    def change(asked, status):
        if 2 <= asked < 5:
            raise error
        return status

    answering(monkeypatch, change)
    replay_into(mapper, log_of(tmp_path / "log.jsonl", 200, beams=8))
    assert capsys.readouterr().out.endswith("log.jsonl: 200 scans sent, 200 integrated\n")


STARTS = MapperError("starting", 503, "it starts")


def test_a_mapper_that_starts_when_the_replay_does_is_waited_for(mapper, tmp_path, monkeypatch, capsys):
    """What it then counts is no loss of ours: its start came before the first message."""

    def change(asked, status):
        if asked < 3:
            raise STARTS
        return status

    answering(monkeypatch, change)
    log = log_of(tmp_path / "log.jsonl", 50, beams=8)
    replay_into(mapper, log)
    assert capsys.readouterr().out.endswith("log.jsonl: 50 scans sent, 50 integrated\n")


@pytest.mark.parametrize(
    ("error", "patience"), [(NobodyAnswered("nobody"), 600.0), (STARTS, 0.2)], ids=["nobody", "starts"]
)
def test_no_mapper_is_waited_for_in_vain(mapper, tmp_path, monkeypatch, error, patience):
    """At the start: none that is not there, and none that starts for too long."""

    def change(*_):
        raise error

    answering(monkeypatch, change)
    monkeypatch.setattr(replay, "START_PATIENCE", patience)
    with pytest.raises(type(error), match=str(error)[:4]):
        replay_into(mapper, log_of(tmp_path / "log.jsonl", 5, beams=8))


@pytest.mark.parametrize("error", [NobodyAnswered("away"), MapperError("no-map", 404, "what?")])
def test_a_mapper_that_stays_away_or_refuses_is_a_failure(mapper, tmp_path, monkeypatch, error):
    def change(asked, status):
        if asked >= 2:
            raise error
        return status

    answering(monkeypatch, change)
    patience = 0.5 if isinstance(error, NobodyAnswered) else 600.0
    monkeypatch.setattr(replay, "MAPPER_PATIENCE", patience)
    with pytest.raises(type(error), match=str(error)[:4]):
        replay_into(mapper, log_of(tmp_path / "log.jsonl", 200, beams=8))


def test_a_mapper_that_was_started_anew_meanwhile_is_a_failure(mapper, tmp_path, monkeypatch):
    seen = []

    def change(_, status):
        logged = status.robots.get("logged")
        seen.append(logged is not None and logged.sources.get("laser", NONE_YET).received > 0)
        return replace(status, robots={}) if seen.count(True) > 1 else status

    answering(monkeypatch, change)
    with pytest.raises(ReplayFailed, match=r"^the mapper was started anew meanwhile: reset its map"):
        replay_into(mapper, log_of(tmp_path / "log.jsonl", 200, beams=8))


@pytest.mark.parametrize("away", [True, False])
def test_poses_that_are_lost_while_the_mapper_is_away_are_a_failure(mapper, tmp_path, monkeypatch, away):
    """Of other robots' poses that are lost, as some are all day, it says nothing."""

    def change(asked, status):
        if away and asked == 2:
            raise NobodyAnswered("away")
        return status if asked < 2 else replace(status, poses=replace(status.poses, lost=3))

    answering(monkeypatch, change)
    failure = pytest.raises(ReplayFailed, match=r"^200 .* 200 integrated, 3 poses lost while .* was away$")
    with failure if away else nullcontext():
        replay_into(mapper, log_of(tmp_path / "log.jsonl", 200, beams=8))


def test_it_keeps_nothing_for_a_mapper_that_comes_later(mapper, tmp_path, eventually):
    """What it has sent is in its file, and scans of several robots are taken in its order."""
    tokens, liveliness = [], mapper.session.liveliness()
    keys = [f"ogm/v1/hall/robots/{robot}/scan/laser/@adv/**" for robot in ("logged", "other")]
    declared = [liveliness.declare_subscriber(key, tokens.append) for key in keys]
    replay_into(mapper, log_of(tmp_path / "log.jsonl", 20, beams=8))
    with RobotPublisher("other", address=mapper.endpoint, map_name="hall", reliable=True) as robot:
        robot.publish_scan([1.0], angle_min=0.0, angle_increment=0.1, range_min=0.0, range_max=8.0)
        eventually(lambda: tokens)  # who keeps something has a token
    for subscriber in declared:
        subscriber.undeclare()
    assert {str(token.key_expr).split("/")[4] for token in tokens} == {"other"}


def test_it_ends_when_its_own_scans_are_in(mapper, tmp_path, capsys):
    with another_robot(mapper):
        replay_into(mapper, log_of(tmp_path / "log.jsonl", 200, beams=8))
    assert capsys.readouterr().out.endswith("log.jsonl: 200 scans sent, 200 integrated\n")


def test_scans_that_the_mapper_refuses_are_a_failure(start_mapper, tmp_path):
    log = log_of(tmp_path / "log.jsonl", 20, beams=9)
    with (
        start_mapper(mapper={"max_beams": 8}) as mapper,
        pytest.raises(ReplayFailed, match=r"^20 scans sent, 0 integrated, 20 dropped: malformed$"),
    ):
        replay_into(mapper, log)


def test_it_gives_up_on_a_mapper_that_takes_nothing_of_its_own(start_mapper, tmp_path, monkeypatch):
    monkeypatch.setattr(replay, "MAPPER_PATIENCE", 0.5)
    log = log_of(tmp_path / "log.jsonl", 200, beams=9)
    # What is malformed has no seq, so the mapper never says that it has taken any of it.
    with (
        start_mapper(mapper={"max_beams": 8}) as mapper,
        another_robot(mapper),
        pytest.raises(ReplayFailed, match=r"stopped taking scans: 64 scans sent, 0 integrated, 64 dropped"),
    ):
        replay_into(mapper, log)


def test_scans_of_one_robot_too_many_are_a_failure_that_is_named(mapper, tmp_path, monkeypatch):
    monkeypatch.setattr(replay, "MAPPER_PATIENCE", 0.5)
    monkeypatch.setattr(receipts, "MAX_ROBOTS", 1)
    mapper.scan([1.0], robot="first", pose=[0.0, 0.0, 0.0])
    mapper.settle(received=1)
    with pytest.raises(ReplayFailed, match=r"20 scans sent, 0 integrated, 20 dropped: refused$"):
        replay_into(mapper, log_of(tmp_path / "log.jsonl", 20, beams=8))


def test_one_stamp_far_ahead_or_a_clock_set_back_does_not_end_the_pace(monkeypatch):
    now, pauses = [100.0], []

    def sleep(seconds):
        pauses.append(round(seconds, 6))
        now[0] += seconds

    monkeypatch.setattr(replay, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=sleep))
    pace = replay._Pace(2.0)
    second = 10**9
    for stamp in (0, second, second // 2, 2**63 - 1, 2 * second, 3 * second, 2 * second, 4 * second):
        pace.wait_for(stamp)
    assert pauses == [0.5, 5.0, 0.5, 0.5]


def test_a_recorded_run_gets_a_fresh_name_no_longer_than_a_name_may_be(mapper, tmp_path):
    recorded = ["", "r", "r" * 55, "r" * 55 + "1", "r" * 55 + "2", "r" * 64]
    scan = Scan(7, 0.0, 0.1, 0.0, 8.0, np.ones(8, np.float32), pose=IDENTITY, seq=5)
    scans = [RecordedScan("logged", f"s{k}", replace(scan, run=run)) for k, run in enumerate(recorded)]
    write_jsonl(tmp_path / "log.jsonl", scans)
    seen = set()
    for _ in range(2):
        replay_into(mapper, tmp_path / "log.jsonl")
        sources = mapper.status()["robots"]["logged"]["sources"]
        runs = [sources[f"s{k}"]["run"] for k in range(len(recorded))]
        fresh = runs[0]
        assert re.fullmatch("[0-9a-f]{8}", fresh)
        digests = [hashlib.sha256(run.encode()).hexdigest()[:16] for run in recorded[3:]]
        assert runs[1:] == [f"{fresh}.{ending}" for ending in (*recorded[1:3], *digests)]
        assert [source["last_seq"] for source in sources.values()] == [0, 5, 5, 5, 5, 5]
        seen |= set(runs)
    assert len(seen) == 12


def heavy_log(path, *, robots, scans, beams, metres):
    """A log in which robots take turns with scans of many long beams."""
    ranges = np.full(beams, metres, np.float32)
    fields = {"angle_min": 0.0, "angle_increment": 1e-3, "range_min": 0.0, "range_max": 1000.0}
    recorded = (
        RecordedScan(f"r{robot}", "laser", Scan(k, ranges=ranges, pose=Pose(5.0, 5.0, 0.1), **fields))
        for k in range(scans)
        for robot in range(robots)
    )
    write_jsonl(path, recorded)
    return path


@pytest.mark.parametrize(
    ("robots", "scans", "beams", "metres"),
    [(100, 50, 4, 1.0), (100, 2, 1000, 900.0), (2, 40, 5000, 900.0)],
    ids=["many", "many and heavy", "heavier"],
)
def test_as_fast_as_it_goes_it_never_fills_the_queue(
    start_mapper, tmp_path, capsys, robots, scans, beams, metres
):
    log = heavy_log(tmp_path / "log.jsonl", robots=robots, scans=scans, beams=beams, metres=metres)
    bounds = [0.0, 0.0, 10.0, 10.0]
    waited = []
    with start_mapper(map={"resolution": 0.05, "bounds": bounds}) as mapper:
        # A slow machine: nothing is taken for a moment, again and again.
        integrate = mapper.service.live_map.integrate

        def slowly(*placed):
            waited.append((mapper.service.parts.queue.scans, mapper.service.parts.queue.bytes))
            if len(waited) % 500 == 1:
                time.sleep(0.3)
            return integrate(*placed)

        mapper.service.live_map.integrate = slowly
        replay_into(mapper, log)
        status = mapper.status()
    assert capsys.readouterr().out.endswith(f"{robots * scans} scans sent, {robots * scans} integrated\n")
    assert status["scans"]["dropped"]["overload"] == 0
    most_scans, most_bytes = (max(values) for values in zip(*waited, strict=True))
    assert most_scans <= on_the_way.MAX_SCANS
    assert most_bytes <= on_the_way.MAX_BYTES + on_the_way.MAX_SCANS * 300  # and what is around the ranges
    cells = on_the_way.size_of(
        Scan(0, 0.0, 1e-3, 0.0, 1000.0, np.full(beams, metres, np.float32)), 0.05
    ).cells
    assert most_scans <= max(1, on_the_way.MAX_CELLS / cells)


def test_a_share_is_given_back_as_scans_are_taken():
    way, size = OnTheWay(), Size(on_the_way.MAX_BYTES // 4, 1.0)
    a, b = Source("a", "s"), Source("b", "s")
    for seq in range(4):
        assert way.room_for(a, size)
        way.add(a, "run", seq, size)
    assert not way.room_for(b, size)
    way.taken(a, "run", 17)
    assert not way.room_for(b, size)
    way.taken(a, "run", 1)
    assert way.room_for(b, size)
    assert way.room_for(b, size, 0.75)
    assert not way.room_for(b, size, 0.5)
    way.none_waits(a)
    assert (way.scans, way.size, way.cells) == (0, 0, 0.0)
    way.taken(a, "run", 3)
    assert (way.scans, way.size, way.cells, len(way.sent[a])) == (0, 0, 0.0, 0)
    for seq in range(4, 4 + on_the_way.MAX_AHEAD):
        assert way.room_for(a, Size(1, 1.0))
        way.add(a, "run", seq, Size(1, 1.0))
    assert not way.room_for(a, Size(1, 1.0))
    way.none_waits(a)
    assert not way.room_for(a, Size(1, 1.0))  # it is never more than that ahead of what is taken
    assert way.room_for(b, Size(1, 1.0))
    giant = Size(2 * on_the_way.MAX_BYTES, 1.0)
    assert way.room_for(b, giant)  # alone
    way.add(b, "run", 0, Size(1, 1.0))
    assert not way.room_for(b, giant)
    assert not way.room_for(b, Size(1, on_the_way.MAX_CELLS))


def test_a_size_is_that_of_beams_and_of_sectors():
    scan = Scan(0, 0.0, 0.1, 0.0, 8.0, np.array([1.0, np.inf, np.nan, -1.0], np.float32))
    assert on_the_way.size_of(scan, 0.5) == (16, pytest.approx(34.0 + 0.05 * (4.0 + 256.0 + 256.0)))
