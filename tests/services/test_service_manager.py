"""ServiceManager: who is told, of what, and what is left in the environment."""

import os
import socket

import pytest

from ogm_services.mapper.live import watch
from ogm_services.mapper.service import MapperService, run_mapper
from ogm_services.runtime.service_manager import ServiceManager
from ogm_services.settings.settings import Settings

WATCHED = {"WATCHDOG_USEC": "1000000", "WATCHDOG_PID": str(os.getpid())}


@pytest.fixture
def listening(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(str(tmp_path / "notify"))
        listening.settimeout(0.0)
        yield listening


def heard(listening):
    """All that was told so far."""
    notices = []
    while True:
        try:
            notices.append(listening.recv(4096).decode())
        except BlockingIOError:
            return notices


def manager(listening, **environ):
    return ServiceManager({"NOTIFY_SOCKET": listening.getsockname(), **environ})


def test_it_is_told_in_its_own_words(listening):
    told = manager(listening, **WATCHED)
    told.ready("live map http://127.0.0.1:8000/")
    told.alive()
    told.stopping("so it is")
    assert heard(listening) == [
        "READY=1\nSTATUS=live map http://127.0.0.1:8000/",
        "WATCHDOG=1",
        "STOPPING=1\nSTATUS=so it is",
    ]


@pytest.mark.parametrize(
    "environ",
    [{}, {"WATCHDOG_USEC": "0"}, {"WATCHDOG_USEC": "soon"}, {**WATCHED, "WATCHDOG_PID": "1"}],
)
def test_who_does_not_watch_this_process_is_not_told_that_it_lives(listening, environ):
    told = manager(listening, **environ)
    told.ready("up")
    told.alive()
    assert heard(listening) == ["READY=1\nSTATUS=up"]


def test_what_is_not_up_is_not_said_to_live(listening):
    manager(listening, **WATCHED).alive()
    assert heard(listening) == []


def test_children_do_not_inherit_the_socket():
    environ = {"NOTIFY_SOCKET": "/nowhere", **WATCHED, "HOME": "/root"}
    ServiceManager(environ)
    assert environ == {"HOME": "/root"}


def test_without_one_nobody_is_told(caplog):
    told = ServiceManager({})
    told.ready("up")
    told.alive()
    told.stopping("down")
    assert caplog.messages == []


def test_one_that_has_gone_is_no_failure(caplog):
    ServiceManager({"NOTIFY_SOCKET": "/nowhere/notify"}).ready("up")
    (said,) = caplog.messages
    assert said.startswith("NOTIFY_SOCKET /nowhere/notify: 'READY=1\\nSTATUS=up' is not told: ")


def test_a_mapper_whose_worker_has_ended_is_not_said_to_live(listening, monkeypatch, eventually):
    monkeypatch.setenv("NOTIFY_SOCKET", listening.getsockname())
    monkeypatch.setenv("WATCHDOG_USEC", "1000000")
    monkeypatch.setattr(watch, "LOOK_PERIOD", 0.01)
    after = []

    def wait(service):
        eventually(lambda: "WATCHDOG=1" in heard(listening))
        service.parts.worker.stop()
        looks = []
        service.parts.watch.add(looks.append)
        eventually(lambda: len(looks) > 1)
        heard(listening)
        looks.clear()
        eventually(lambda: len(looks) > 10)
        after.extend(heard(listening))
        raise KeyboardInterrupt

    monkeypatch.setattr(MapperService, "wait", wait)
    settings = {"network": {"listen": ["tcp/127.0.0.1:0"]}, "http": {"port": 0}}
    with pytest.raises(KeyboardInterrupt):
        run_mapper(Settings.model_validate(settings), None)
    assert after == []
    assert [notice.split("\n")[0] for notice in heard(listening)] == ["STOPPING=1"]
