"""Bugs of the mapper: each is counted and logged, and the rest goes on; or it says that it ends."""

import json
import sys

import numpy as np
import pytest

from mapper_desk import Desk, Sink
from ogm_core.errors import BadInput
from ogm_core.types import Pose, Scan
from ogm_services.mapper import service as service_module
from ogm_services.mapper.intake import worker as worker_module
from ogm_services.mapper.service import MapperService, ServiceStopped, run_mapper
from ogm_services.settings.settings import Settings

HERE = [0.25, 0.25, 0.0]


def failures(caplog):
    """What was logged as failed, and the kind of error of its traceback."""
    records = [record for record in caplog.records if record.levelname == "ERROR"]
    return [(record.getMessage(), record.exc_info[0]) for record in records]


def fail_once(monkeypatch, owner, name):
    """Make the next call of `owner.name` fail; returns the calls that were made, as booleans: failed."""
    works, calls = getattr(owner, name), []

    def call(*args, **options):
        calls.append(not calls)
        if calls[-1]:
            raise ZeroDivisionError(f"a bug in {name}")
        return works(*args, **options)

    monkeypatch.setattr(owner, name, call)
    return calls


def test_a_scan_that_meets_a_bug_is_counted_and_those_that_waited_with_it_are_placed():
    desk = Desk(Sink({1: ZeroDivisionError("one"), 3: KeyError("three")})).pose(0)
    for ms in range(1, 6):
        desk.scan(ms)
    assert (desk.order, desk.pending) == ([], 5)
    with pytest.raises(ExceptionGroup, match="scans of r that waited for this pose") as caught:
        desk.pose(4)
    assert [str(bug) for bug in caught.value.exceptions] == ["one", "'three'"]
    desk.check()
    assert (desk.order, desk.pending, desk.dropped) == ([0, 2], 1, {"failed": 2})
    desk.pose(5)
    assert (desk.order, desk.pending) == ([0, 2, 4], 0)


def test_a_scan_with_a_pose_of_its_own_that_meets_a_bug_is_counted():
    desk = Desk(Sink({0: ZeroDivisionError("one")}))
    with pytest.raises(ZeroDivisionError, match="one"):
        desk.scan(1, pose=Pose(0.0, 0.0, 0.0))
    desk.check()
    assert (desk.pending, desk.dropped) == (0, {"failed": 1})


@pytest.mark.parametrize("place", ["the map", "the decoder"])
def test_mapping_goes_on_after_a_bug(start_mapper, monkeypatch, caplog, place):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        if place == "the map":
            fail_once(monkeypatch, mapper.service.live_map._grid, "integrate")
        else:
            fail_once(monkeypatch, worker_module, "decode_scan")
        mapper.scan([1.0], pose=HERE)
        scans = mapper.settle(received=1)["scans"]
        assert (scans["integrated"], scans["dropped"]["failed"]) == (0, 1)
        mapper.scan([1.0], pose=HERE)
        status = mapper.settle(received=2)
        assert (status["revision"], status["scans"]["integrated"], status["scans"]["dropped"]["failed"]) == (
            *(1, 1, 1),
        )
        assert 'ogm_scans_dropped_total{map="hall",reason="failed"} 1' in mapper.http.get("/metrics").text
    assert failures(caplog) == [("a message of r/s failed", ZeroDivisionError)]


def test_no_memory_is_a_limit_and_no_bug(mapper, monkeypatch):
    def no_memory(*_):
        raise MemoryError

    monkeypatch.setattr(mapper.service.live_map._grid, "_add", no_memory)
    mapper.scan([1.0], pose=HERE)
    dropped = mapper.settle(received=1)["scans"]["dropped"]
    assert {reason: count for reason, count in dropped.items() if count} == {"limit": 1}


def test_a_bug_in_the_look_for_silent_robots_does_not_end_the_worker(
    start_mapper, monkeypatch, caplog, eventually
):
    with start_mapper(map={"resolution": 0.5}, mapper={"pose_wait": 0.2}) as mapper:
        calls = fail_once(monkeypatch, mapper.service.parts.worker._placer, "expire")
        eventually(lambda: len(calls) > 2)
        assert mapper.http.get("/livez").status_code == 200
        assert mapper.draw_cross()["revision"] == 3
        mapper.scan([1.0], robot="silent")
        assert mapper.settle(received=4)["scans"]["dropped"]["no_pose"] == 1
    assert failures(caplog) == [("a look for silent robots failed", ZeroDivisionError)]


def test_a_bug_that_comes_back_with_every_scan_does_not_fill_the_log(start_mapper, monkeypatch, caplog):
    with start_mapper(map={"resolution": 0.5}) as mapper:

        def fail(*_):
            raise ZeroDivisionError

        monkeypatch.setattr(mapper.service.live_map._grid, "integrate", fail)
        for seq in range(200):
            mapper.scan([1.0], pose=HERE, seq=seq)
        assert mapper.settle(received=200)["scans"]["dropped"]["failed"] == 200
    assert 1 <= len(failures(caplog)) < 20


@pytest.mark.parametrize("stopped", ["HTTP", "the worker"])
def test_a_thread_that_ends_by_itself_ends_the_mapper_with_its_map_written(tmp_path, monkeypatch, stopped):
    wait = MapperService.wait

    def stop_and_wait(service):
        scan = Scan(0, 0.0, 0.1, 0.0, 8.0, np.ones(1, np.float32))
        service.live_map.integrate(scan, Pose(0.25, 0.25, 0.0))
        if stopped == "HTTP":
            service._http_thread._server.should_exit = True
        else:
            service.parts.queue.close()
        wait(service)

    monkeypatch.setattr(MapperService, "wait", stop_and_wait)
    monkeypatch.setattr(service_module, "WAKE_PERIOD", 0.05)
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    network = {"listen": ["tcp/127.0.0.1:0"]}
    settings = Settings.model_validate({"network": network, "http": {"port": 0}})
    with pytest.raises(ServiceStopped) as caught:
        run_mapper(settings, tmp_path / "out")
    assert str(caught.value) == f"{stopped} has stopped by itself, so the mapper ends: start it again"
    assert not isinstance(caught.value, BadInput)  # exit code 1
    assert json.loads((tmp_path / "out" / "quality.json").read_text())["scans"] == 1
