"""A replay judges the mapper by the log's own scans, whatever other robots do meanwhile."""

import hashlib
import re
import threading
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from ogm_core.logs.recordings import RecordedScan, write_jsonl
from ogm_core.types import IDENTITY, Scan
from ogm_services.commands import replay
from ogm_services.commands.replay import ReplayFailed, run_replay
from ogm_services.settings.settings import NetworkSettings


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
    run_replay(log, network, speed=None, range_max=None, robot=None)


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
    monkeypatch.setattr(replay, "PATIENCE", 0.5)
    log = log_of(tmp_path / "log.jsonl", 200, beams=9)
    # What is malformed has no seq, so the mapper never says that it has taken any of it.
    with (
        start_mapper(mapper={"max_beams": 8}) as mapper,
        another_robot(mapper),
        pytest.raises(ReplayFailed, match=r"stopped taking scans: 64 scans sent, 0 integrated, 64 dropped"),
    ):
        replay_into(mapper, log)


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
