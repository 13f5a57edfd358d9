"""Connections that are open for nothing: idle, half-sent, stalled, too many. Deadlines are short here."""

import resource
import socket
from contextlib import ExitStack

import pytest

from http_desk import BIG, answer_from, get, http_desk
from ogm_services.mapper.serving.http_limits import HttpLimits

SHORT, NEVER = 0.5, 3600.0
HALVES = {
    "half a line": b"GET /ma",
    "half a head": b"GET / HTTP/1.1\r\nHost: a\r\nA: b",
    "no end of the head": b"GET / HTTP/1.1\r\nHost: a\r\n",
    "half a body": b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 9\r\n\r\nabc",
    "half a chunk": b"POST / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n9\r\nabc",
}


def closed(sock):
    """Whether the server has closed a connection, without another word."""
    try:
        return sock.recv(1) == b""
    except ConnectionResetError:
        return True


def test_what_stands_in_the_limits():
    limits = HttpLimits()
    assert (limits.request_time, limits.stall_time, limits.connections) == (60.0, 20.0, 1000)


def test_an_idle_connection_is_closed():
    with http_desk(request_time=SHORT) as desk, desk.call() as never, desk.call() as once:
        with once.makefile("rb") as file:
            once.sendall(get())
            assert answer_from(file).status == 200
            assert file.read(1) == b""
        assert closed(never)
        assert desk.closed == []


@pytest.mark.parametrize("half", HALVES.values(), ids=HALVES)
@pytest.mark.parametrize("before", [b"", get()], ids=["first", "second"])
def test_half_a_request_is_told_so_and_closed(half, before):
    with http_desk(request_time=SHORT) as desk:
        *first, answer = desk.say(before, half)
        assert [answer.status for answer in first] == ([200] if before else [])
        assert answer.problem() == (408, "request-timeout")
        assert desk.closed == ["request-timeout"]
        assert [path for _, path, _ in desk.seen] == (["/"] if before else [])


def test_sending_a_byte_now_and_then_does_not_help():
    with http_desk(request_time=SHORT) as desk, desk.call() as sock:
        sock.settimeout(SHORT / 10)
        sock.sendall(b"GET / HTTP/1.1\r\nHost: a\r\nA: ")
        for _ in range(1000):
            try:
                assert sock.recv(100).startswith(b"HTTP/1.1 408 ")
                return
            except TimeoutError:
                sock.sendall(b"a")
    pytest.fail("it is still open")


def test_who_asks_again_and_again_is_not_closed():
    with http_desk(request_time=SHORT) as desk, desk.call() as sock, sock.makefile("rb") as file:
        for _ in range(30):
            sock.sendall(get())
            assert answer_from(file).status == 200
            with pytest.raises(TimeoutError):
                wait_for_more(sock, SHORT / 10)


def wait_for_more(sock, seconds):
    sock.settimeout(seconds)
    try:
        sock.recv(1, socket.MSG_PEEK)
    finally:
        sock.settimeout(30.0)


def test_clients_that_do_not_read_are_closed(eventually):
    """They have asked for more than fits into the buffers of both sides."""
    with http_desk(stall_time=1.0, request_time=NEVER) as desk, ExitStack() as stack:
        for sock in [stack.enter_context(desk.call()) for _ in range(10)]:
            sock.sendall(get(b"/big"))
        eventually(lambda: len(desk.seen) == 10)
        eventually(lambda: desk.connections() == 0)
        eventually(lambda: desk.closed == ["stalled"] * 10)


def test_a_byte_now_and_then_is_no_progress():
    """Less than a segment does not open the window again, so nothing can be sent."""
    with http_desk(stall_time=1.0, request_time=NEVER) as desk, desk.call() as sock:
        sock.sendall(get(b"/big"))
        for taken in range(BIG):
            if taken and not desk.connections():
                break
            assert len(sock.recv(1)) == 1
            with pytest.raises(TimeoutError):
                event_that_never_comes(0.1)
        assert taken < 1000


def test_200_idle_200_half_and_50_stalled_clients_keep_nobody_else_waiting(eventually):
    """Whoever asks is answered all the while, and in the end nobody else is there."""
    with http_desk(stall_time=2.0, request_time=2.0) as desk, ExitStack() as stack:
        for said, clients in ((b"", 200), (b"GET / HT", 200), (get(b"/big"), 50)):
            for _ in range(clients):
                stack.enter_context(desk.call()).sendall(said)

        def alone():
            (answer,) = desk.say(get(b"/healthy", b"Connection: close"))
            assert answer.status == 200
            return desk.connections() == 0

        eventually(lambda: len([path for _, path, _ in desk.seen if path == "/big"]) == 50)
        eventually(alone)


def test_a_client_that_reads_slowly_gets_everything():
    """Some bytes in every stall_time are progress; all of it takes several of them."""
    with http_desk(stall_time=4.0, request_time=SHORT) as desk, desk.call() as sock:
        sock.sendall(get(b"/big"))
        got = 0
        with sock.makefile("rb", buffering=0) as file:
            for _ in range(8):
                with pytest.raises(TimeoutError):
                    event_that_never_comes(0.6)
                got += len(read_exactly(file, BIG // 16))
            rest = answer_rest(file)
        assert got + rest > BIG


def event_that_never_comes(seconds):
    """Wait, as a slow client does."""
    left, right = socket.socketpair()
    with left, right:
        left.settimeout(seconds)
        left.recv(1)


def read_exactly(file, size):
    parts = []
    while size:
        part = file.read(min(size, 1 << 20))
        assert part, "closed too soon"
        parts.append(part)
        size -= len(part)
    return b"".join(parts)


def answer_rest(file):
    total = 0
    while part := file.read(1 << 20):
        total += len(part)
    return total


def test_beyond_the_limit_who_waits_longest_makes_room():
    """The newcomer is answered, whoever holds all the rest open."""
    with http_desk(connections=5, request_time=NEVER) as desk, ExitStack() as stack:
        held = [stack.enter_context(desk.call()) for _ in range(5)]
        for sock in held[1:]:
            with sock.makefile("rb") as file:
                sock.sendall(get())
                assert answer_from(file).status == 200
        for _ in range(3):
            (answer,) = desk.say(get(b"/", b"Connection: close"))
            assert answer.status == 200
        assert closed(held[0])
        assert set(desk.closed) == {"full"}
        last = held[-1]
        with last.makefile("rb") as file:
            last.sendall(get())
            assert answer_from(file).status == 200


def test_a_newcomer_does_not_cut_an_answer_off(caplog):
    with http_desk(connections=2) as desk, ExitStack() as stack:
        sockets = [stack.enter_context(desk.call()) for _ in range(2)]
        files = [stack.enter_context(sock.makefile("rb")) for sock in sockets]
        for sock, file in zip(sockets, files, strict=True):
            sock.sendall(get(b"/big", b"Connection: close"))
            assert file.readline() == b"HTTP/1.1 200 OK\r\n"
        with desk.call() as newcomer:
            assert closed(newcomer)
        for file in files:
            assert answer_rest(file) > BIG
    assert any("2 connections are open" in record.getMessage() for record in caplog.records)


def test_thousands_of_connections_leave_files_for_others(eventually, caplog, monkeypatch):
    """A process that may open few files serves fewer connections, says so, and always has some left."""
    monkeypatch.setattr(resource, "getrlimit", lambda _: (64, 64))
    with http_desk(request_time=NEVER) as desk, ExitStack() as stack:
        (line,) = [record.getMessage() for record in caplog.records]
        assert line.startswith("at most 32 HTTP connections: this process may open 64 files (ulimit -n)")
        held = [stack.enter_context(desk.call()) for _ in range(100)]
        (answer,) = desk.say(get(b"/", b"Connection: close"))
        assert answer.status == 200
        assert all(closed(sock) for sock in held[:60])


def test_more_files_are_asked_for(monkeypatch):
    asked = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: (1024, 65536))
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: asked.append(limits))
    with http_desk():
        assert asked == [(4000, 65536)]
