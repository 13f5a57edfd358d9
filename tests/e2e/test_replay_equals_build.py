"""`ogm replay` into a mapper of another process gives the map that `ogm build` gives, value for value."""

import gzip
import json
import signal
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from rough_log import write_rough_log
from tests.soak.services import Service

LAP = 10.95
"""Seconds from the first to the last scan of the lab's recording."""


@dataclass(frozen=True)
class Log:
    """A log, the flags that it needs, and what becomes of its scans."""

    path: Path
    scans: int
    dropped: dict = field(default_factory=dict)
    late: int = 0
    log_flags: tuple = ()
    map_flags: tuple = ()


@pytest.fixture
def lab_log(lab_recording):
    return Log(lab_recording, 220)


@pytest.fixture
def lab_preset_log(lab_recording):
    return Log(lab_recording, 220, map_flags=("--preset", "lab"))


@pytest.fixture
def lab_forgetting_log(lab_recording):
    return Log(lab_recording, 220, map_flags=("--half-life", "2"))


@pytest.fixture
def lab_counting_log(lab_recording):
    return Log(lab_recording, 220, map_flags=("--cell-model", "rate"))


@pytest.fixture
def lab_halving_log(lab_recording):
    return Log(lab_recording, 220, map_flags=("--cell-model", "rate", "--half-life", "2"))


@pytest.fixture
def rough_log(tmp_path):
    path = tmp_path / "rough.jsonl"
    return Log(path, *write_rough_log(path))


@pytest.fixture
def intel_log(intel):
    path = intel / "intel-corrected.log.gz"
    return Log(path, 910, log_flags=("--range-max", "80"), map_flags=("--clear-range", "25"))


def built(ogm, log, name="built"):
    """How a build ended; `ogm.map` reads what it made."""
    return ogm.call("build", log.path, "--out", name, *log.log_flags, *log.map_flags)


def replayed(command, log, mapper, *flags):
    """A replay by `ogm.start`, `run` or `call`."""
    flags = flags or ("--speed", "max")
    return command("replay", log.path, "--connect", mapper.endpoint, *log.log_flags, *flags)


@pytest.mark.parametrize(
    "name",
    [
        *("lab_log", "lab_preset_log", "lab_forgetting_log", "lab_counting_log", "lab_halving_log"),
        *("rough_log", "intel_log"),
    ],
)
def test_replayed_and_built_maps_are_equal(ogm, assert_equal_maps, request, name):
    log = request.getfixturevalue(name)
    starting = [ogm.mapper(*log.map_flags) for _ in range(2)]
    build = built(ogm, log)
    mappers = [ogm.ready(command) for command in starting]
    replays = [replayed(run, log, mapper) for run, mapper in zip((ogm.run, ogm.call), mappers, strict=True)]
    assert build.code == 0
    assert bool(build.err) == bool(log.dropped)  # what was wrong with the log, and what to do about it
    expected = ogm.map("built/map.npz")
    integrated = log.scans - sum(log.dropped.values())
    for mapper, ended in zip(mappers, replays, strict=True):
        assert (ended.code, ended.err) == (0, "")
        assert f"{log.scans} scans sent, {integrated} integrated" in ended.out
        for reason, count in log.dropped.items():
            assert f"{count} dropped: {reason}" in ended.out
        assert_equal_maps(mapper.map(), expected)
        status = mapper.status()
        assert {reason: n for reason, n in status["scans"]["dropped"].items() if n} == log.dropped
        assert (status["scans"]["received"], status["poses"]["late"]) == (log.scans, log.late)
        assert (status["revision"], status["scans"]["pending"]) == (integrated, 0)


def test_a_log_replayed_twice_is_mapped_twice(ogm, lab_log, assert_equal_maps):
    twice = lab_log.path.read_text()
    ogm.file("twice.jsonl", twice + twice.replace('"run":"seed-1"', '"run":"again"'))
    assert ogm.call("build", "twice.jsonl", "--out", "built").code == 0
    mapper = ogm.ready(ogm.mapper())
    for count in (220, 440):
        assert replayed(ogm.call, lab_log, mapper).code == 0
        assert mapper.status()["revision"] == count
    assert_equal_maps(mapper.map(), ogm.map("built/map.npz"))


def test_a_log_is_replayed_at_its_own_pace(ogm, lab_log, assert_equal_maps):
    starting, build = ogm.mapper(), built(ogm, lab_log)
    mapper = ogm.ready(starting)
    for count, speed in ((220, 50), (440, 5)):
        ended = replayed(ogm.call, lab_log, mapper, "--speed", speed)
        assert (ended.code, ended.err) == (0, "")
        assert ended.seconds > LAP / speed
        assert mapper.status()["revision"] == count
        if count == 220:
            assert build.code == 0
            assert_equal_maps(mapper.map(), ogm.map("built/map.npz"))


def test_malformed_lines_are_reported(ogm, lab_log):
    lines = lab_log.path.read_text().splitlines()
    ogm.file(
        "bad.jsonl", "\n".join([lines[0], "{", *lines[1:9], '{"type": "scan"}', *lines[9:20], "x" * 9999])
    )
    mapper = ogm.ready(ogm.mapper())
    ended = ogm.call("replay", "bad.jsonl", "--connect", mapper.endpoint, "--speed", "max", "--robot", "r7")
    assert (ended.code, ended.err) == (0, "")
    assert "10 scans sent, 10 integrated, 3 malformed lines passed over (line 2: not JSON" in ended.out
    assert "line 11: robot: missing" in ended.out
    assert len(ended.out) < 1000
    status = mapper.status()
    assert status["scans"]["received"] == status["revision"] == 10
    assert status["robots"].keys() == {"r7"}


def test_a_bad_log_is_bad_input_and_nothing_is_sent(ogm, lab_log, idle_mapper):
    packed = gzip.compress(lab_log.path.read_bytes())
    (ogm.folder / "cut.jsonl.gz").write_bytes(packed[: len(packed) // 2])
    ogm.file("poses.jsonl", lab_log.path.read_text().splitlines()[0])
    ogm.file("empty.jsonl", "")
    logs = ["missing.jsonl", "cut.jsonl.gz", "poses.jsonl", "empty.jsonl"]
    for name in logs:
        assert name in ogm.call("replay", name, "--connect", idle_mapper.endpoint).complaint(2)
    assert idle_mapper.status()["poses"]["received"] == idle_mapper.status()["scans"]["received"] == 0


def test_without_a_mapper_it_says_what_to_check(ogm, lab_log, idle_mapper, endpoint):
    nobody = ogm.run("replay", lab_log.path, "--connect", endpoint)
    other_map = ogm.call("replay", lab_log.path, "--connect", idle_mapper.endpoint, "--map", "hall")
    complaint = nobody.complaint(1)
    assert endpoint in complaint
    assert "ogm mapper" in complaint
    assert "no mapper of map 'hall'" in other_map.complaint(1)
    assert idle_mapper.status()["poses"]["received"] == 0


def test_a_mapper_that_dies_midway_is_a_failure(ogm, lab_log, eventually):
    mapper = ogm.ready(ogm.mapper())
    replay = replayed(ogm.start, lab_log, mapper, "--speed", "2")
    eventually(lambda: mapper.status()["revision"] > 10)
    mapper.command.stop(signal.SIGKILL)
    assert "no mapper of map 'default' answered" in replay.wait().complaint(1)


def test_what_a_router_that_is_away_for_a_while_loses_is_told(ogm, lab_log, endpoint, eventually):
    """The rest of the log is in the map: the replay goes on when the router is back."""
    with Service("tests.soak.router", endpoint) as router:
        mapper = ogm.ready(ogm.start("mapper", "--http-port", "0", "--connect", endpoint))
        replay = ogm.start("replay", lab_log.path, "--connect", endpoint, "--speed", "2")
        eventually(lambda: mapper.status()["revision"] > 10)
        router.end()
        before = mapper.status()["revision"]
        router.start()
        ended = replay.wait()
        received = mapper.status()["scans"]["received"]
        assert before + 20 < received < 220
        assert (ended.code, ended.out) == (1, "")
        assert ended.err.startswith("ogm: the mapper stopped taking scans: 220 scans sent")
        assert ended.err.endswith(f", {220 - received} never received\n")
        mapper.command.stop()  # before its router, which it would look for


def test_scans_that_the_mapper_had_no_room_for_are_a_failure(ogm):
    # Each scan keeps the worker busy for longer than the next one takes to come, and the queue is far smaller
    # than the share that a replay keeps to.
    scan = {
        "type": "scan", "robot": "r1", "sensor": "s", "run": "a", "angle_min": 0.0, "angle_increment": 6e-3,
        "range_min": 0.0, "range_max": 200.0, "ranges": [100.0] * 1000, "pose": [0.0, 0.0, 0.0],
    }  # fmt: skip
    ogm.file("big.jsonl", "\n".join(json.dumps({**scan, "stamp": k, "seq": k}) for k in range(60)))
    mapper = ogm.ready(ogm.mapper(OGM_MAPPER__QUEUE="1"))
    ended = ogm.call("replay", "big.jsonl", "--connect", mapper.endpoint, "--speed", "max")
    scans = mapper.status()["scans"]
    assert scans["dropped"]["overload"] > 0
    assert scans["integrated"] + scans["dropped"]["overload"] == scans["received"] == 60
    complaint = (
        f"60 scans sent, {scans['integrated']} integrated, {scans['dropped']['overload']} dropped: overload"
    )
    assert ended.complaint(1) == f"ogm: {complaint}\n"


def test_an_interrupted_replay_is_not_a_success(ogm, lab_log, eventually):
    mapper = ogm.ready(ogm.mapper())
    replay = replayed(ogm.start, lab_log, mapper, "--speed", "1")
    eventually(lambda: mapper.status()["revision"] > 0)
    ended = replay.stop(signal.SIGINT)
    assert (ended.code, ended.out, ended.err) == (130, "", "")
