"""What a mapper tells the service manager that has started it, on a socket as systemd has one."""

import secrets
import signal
import socket

import pytest

GIVEN_UP = 60.0


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    """A service manager's socket, and the name by which NOTIFY_SOCKET tells it."""
    abstract = request.param == "abstract"
    name = f"@ogm-{secrets.token_hex(8)}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(name.replace("@", "\0", 1) if abstract else name)
        listening.settimeout(GIVEN_UP)
        yield name, listening


def heard(listening):
    """The next notice, by its variables."""
    return dict(line.split("=", 1) for line in listening.recv(4096).decode().split("\n"))


def test_it_is_told_when_the_mapper_is_ready_while_it_works_and_that_it_stops(ogm, manager):
    name, listening = manager
    command = ogm.mapper(NOTIFY_SOCKET=name, WATCHDOG_USEC="60000000")
    ready = heard(listening)
    mapper = ogm.ready(command)
    assert ready["READY"] == "1"
    assert mapper.url in ready["STATUS"]
    assert mapper.get("readyz")
    assert [heard(listening) for _ in range(3)] == [{"WATCHDOG": "1"}] * 3
    assert command.stop(signal.SIGTERM).code == 0
    listening.settimeout(0.0)
    notices = [heard(listening)]
    while "STOPPING" not in notices[-1]:
        notices.append(heard(listening))
    assert notices[-1]["STOPPING"] == "1"
    with pytest.raises(BlockingIOError):
        heard(listening)  # nothing after that


def test_a_mapper_that_nobody_listens_to_says_so_and_maps(ogm, tmp_path):
    command = ogm.mapper(NOTIFY_SOCKET=str(tmp_path / "nobody"))
    mapper = ogm.ready(command)
    command.complains("'READY=1")
    assert mapper.get("readyz")
    assert command.stop(signal.SIGTERM).code == 0
