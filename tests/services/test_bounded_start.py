"""A mapper, or gateway, that starts ends within bounded time of a signal, whatever its start is in."""

import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest

from ogm_services.runtime.bounded_start import ended_within

CHILD = """
import ctypes, threading
from contextlib import suppress
from ogm_services.cli import app
from ogm_services.mapper import parts, service
from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber
from ogm_services.mapper.live import first_warm_up
from ogm_services.mapper.serving.other_mappers import OtherMappers
from ogm_services.mapper.serving.zenoh_routes import ZenohRoutes

library, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(256)

def for_ever(*_):
    said = False
    while True:
        with suppress(KeyboardInterrupt):
            if not said:
                said = True
                print("it begins", flush=True)
            if IN_A_LIBRARY:  # no signal ends this, and Python's handlers wait
                library.pthread_mutex_lock(mutex)
            else:
                threading.Event().wait()

service.STOP_TIME = 0.5
"""
GATEWAY = """
from ogm_services.mapper.gateway import gateway_service
from ogm_services.mapper.shares.gathering import Gathering

gateway_service.STOP_TIME = 0.5
"""
PLACES = {
    "restoring a map": "parts.started_grid",
    "connecting": "service.open_session",
    "looking for others": "OtherMappers.claim",
    "declaring": "ZenohRoutes.declare",
    "compiling": "first_warm_up.warm_up",
    "taking the map": "OtherMappers.serve",
    "subscribing": "ZenohSubscriber.declare",
}
ENDING = signal.SIGTERM, signal.SIGINT, signal.SIGHUP


@pytest.fixture
def started():
    """`started(code, *options)` runs a mapper, or another `service`, and kills it at the end."""
    children = []

    def start(code, *options, service="mapper"):
        command = [sys.executable, "-c", f"{code}\napp()\n", service, "--http-port", "0", *options]
        # A shell's background processes ignore SIGINT, and what they start does, too.
        child = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: [signal.signal(number, signal.SIG_DFL) for number in ENDING],
        )
        timer = threading.Timer(120, child.kill)
        timer.start()
        children.append((child, timer))
        return child

    yield start
    for child, timer in children:
        timer.cancel()
        child.kill()
        child.communicate()


@pytest.mark.parametrize("place", PLACES)
def test_a_start_that_does_not_end_ends_with_the_process(started, tmp_path, place):
    in_a_library = list(PLACES).index(place) % 2 == 0
    patch = f"IN_A_LIBRARY = {in_a_library}\n{PLACES[place]} = for_ever"
    child = started(CHILD + patch, "--listen", "tcp/127.0.0.1:0", "--out", str(tmp_path))
    assert "it begins\n" in child.stdout
    child.send_signal(ENDING[list(PLACES).index(place) % 3])
    _, errors = child.communicate()
    assert child.returncode == 1
    (line,) = (line for line in errors.splitlines() if line.startswith("ogm: "))
    assert line.startswith("ogm: the mapper has not stopped within 0.5 s, so it ends as it is: ")
    assert "does not return; threads that go on: " in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("place", ["first_warm_up.warm_up", "Gathering.gather"])
def test_a_gateway_s_start_that_does_not_end_ends_with_the_process(started, place):
    code = f"{CHILD}{GATEWAY}IN_A_LIBRARY = {place == 'Gathering.gather'}\n{place} = for_ever"
    child = started(code, "--listen", "tcp/127.0.0.1:0", service="gateway")
    assert "it begins\n" in child.stdout
    child.send_signal(signal.SIGTERM)
    _, errors = child.communicate()
    assert child.returncode == 1
    (line,) = (line for line in errors.splitlines() if line.startswith("ogm: "))
    assert line.startswith("ogm: the gateway has not stopped within 0.5 s, so it ends as it is: ")
    assert "does not return; threads that go on: " in line


@pytest.mark.parametrize("number", ENDING)
def test_a_start_that_waits_for_a_router_that_says_nothing_ends_at_a_signal(started, number):
    with socket.create_server(("127.0.0.1", 0)) as silent:
        child = started(
            "from ogm_services.cli import app", "--connect", "tcp/{}:{}".format(*silent.getsockname())
        )
        connection, _ = silent.accept()
        with connection:
            connection.settimeout(30)
            assert connection.recv(1)  # its greeting: now it waits for an answer
            began = time.monotonic()
            child.send_signal(number)
            _, errors = child.communicate()
            took = time.monotonic() - began
    assert child.returncode == 0, errors
    assert took < 30.0  # the limit is 10 s, for a machine that is not busy
    assert "Traceback" not in errors


def test_a_start_that_nothing_disturbs_leaves_the_signals_as_they_were():
    before = signal.set_wakeup_fd(-1)
    signal.set_wakeup_fd(before)
    ended = []
    with ended_within(0.0, ended.append):
        pass
    assert signal.set_wakeup_fd(before) == before
    assert not [thread for thread in threading.enumerate() if thread.name == "ogm-start-watch"]
    assert ended == []


def test_an_interruption_that_was_swallowed_comes_at_the_end_of_the_start():
    with pytest.raises(KeyboardInterrupt), ended_within(60.0, lambda _: None), suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
