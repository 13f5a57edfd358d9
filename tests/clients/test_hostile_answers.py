"""Answers that never end, are too long or no mapper's: one deadline, one limit, one line that says why."""

import gzip
import json
import socket
import threading
import time
from contextlib import closing, contextmanager

import pytest

from ogm_client import BadReply, BadSetting, MapClient, MapperError, NobodyAnswered, RobotPublisher

GIVES_UP = 30.0
"""How long a server goes on, s; who is still there then has no deadline."""
OK = b"HTTP/1.1 200 OK\r\n"
LONG = OK + b"Content-Length: 1000000\r\n\r\n"
CHUNKED = OK + b"Transfer-Encoding: chunked\r\n\r\n"


class Server:
    """Sends `head`, then `piece` every `pause` seconds, to everyone who asks; notes how each answer ended."""

    def __init__(self, head, piece=b"", pause=0.0):
        self.head, self.piece, self.pause = head, piece, pause
        self.requests, self.sent, self.ended = [], 0, []

    def run(self, server):
        while True:
            try:
                connection, _ = server.accept()
            except OSError:
                return
            with connection:
                self.requests.append(connection.recv(65536))
                self.answer(connection)

    def answer(self, connection):
        give_up = time.monotonic() + GIVES_UP
        try:
            connection.sendall(self.head)
            while self.piece and time.monotonic() < give_up:
                connection.sendall(self.piece)
                self.sent += len(self.piece)
                time.sleep(self.pause)
        except OSError:
            self.ended.append("the client went")
        else:
            self.ended.append("all was sent")


@contextmanager
def serving(server):
    """Its URL."""
    with closing(socket.create_server(("127.0.0.1", 0))) as listener:
        thread = threading.Thread(target=server.run, args=(listener,))
        thread.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        listener.shutdown(socket.SHUT_RDWR)
    thread.join()


@pytest.mark.parametrize(
    ("head", "piece"),
    [
        (b"", b"H"),
        (OK, b"X"),
        (b"", b"HTTP/1.1 100 Continue\r\n\r\n"),
        (LONG, b"x"),
        (CHUNKED, b"1\r\nx\r\n"),
    ],
    ids=["status line", "headers", "informational answers", "body", "chunks"],
)
def test_an_answer_that_trickles_in_ends_by_the_deadline(head, piece):
    server = Server(head, piece, pause=0.1)
    with serving(server) as url, MapClient(url, timeout=0.5) as client:
        with pytest.raises((NobodyAnswered, BadReply), match=r"status"):
            client.status()
        assert "all was sent" not in server.ended


class StatusFirst(Server):
    """Answers a first question with the status, and sends the rest to the next one."""

    def answer(self, connection):
        connection.sendall(OK + b"Content-Length: 15\r\n\r\n" + b'{"map": "hall"}')
        self.requests.append(connection.recv(65536))
        super().answer(connection)


def test_one_deadline_holds_for_all_that_a_request_asks(http_mapper):
    """The status, which names the map, comes at once; the map itself only trickles in."""
    server = StatusFirst(LONG, b"x", pause=0.1)
    with serving(server) as url, MapClient(url, timeout=0.5, map_name="hall") as client:
        with pytest.raises(NobodyAnswered, match=r"did not answer /map\.npz within 0\.5 s"):
            client.get_map()
        assert "all was sent" not in server.ended


@pytest.mark.parametrize("head", [OK + b"\r\n", CHUNKED, LONG], ids=["until closed", "chunks", "length"])
def test_an_answer_that_is_too_long_is_not_read_on(head):
    piece = b"100000\r\n" + bytes(0x100000) + b"\r\n" if head is CHUNKED else bytes(0x100000)
    server = Server(head, piece)
    with serving(server) as url, MapClient(url, timeout=GIVES_UP, max_bytes=100_000) as client:
        with pytest.raises(BadReply, match=r"/map\.png: longer than 100000 bytes"):
            client.fetch("map.png")
        assert server.sent < 20e6  # what sockets hold


def test_headers_without_end_are_not_read_on():
    server = Server(OK + b"X: ", b"x" * 100_000)
    with serving(server) as url, MapClient(url, timeout=GIVES_UP) as client:
        with pytest.raises(BadReply, match="no HTTP answer to /status"):
            client.status()
        assert server.sent < 20e6


@pytest.mark.parametrize("head", [b"", LONG], ids=["before it begins", "in its body"])
def test_an_answer_that_breaks_off_is_nobody_s(head):
    said = pytest.raises(NobodyAnswered, match="broke off before /status was there")
    with serving(Server(head)) as url, MapClient(url, timeout=GIVES_UP) as client, said:
        client.status()


def test_a_compressed_answer_is_neither_asked_for_nor_unpacked():
    bomb = gzip.compress(bytes(10_000_000))
    server = Server(OK + b"Content-Encoding: gzip\r\nContent-Length: %d\r\n\r\n" % len(bomb) + bomb)
    with (
        serving(server) as url,
        MapClient(url, timeout=GIVES_UP) as client,
        pytest.raises(BadReply, match=r"came compressed \(gzip\)"),
    ):
        client.status()
    assert b"accept-encoding: identity\r\n" in server.requests[0].lower()


def test_nobody_is_sent_elsewhere(http_mapper):
    there = http_mapper.address.encode()
    server = Server(b"HTTP/1.1 302 Found\r\nLocation: " + there + b"/status\r\nContent-Length: 0\r\n\r\n")
    with (
        serving(server) as url,
        MapClient(url, timeout=GIVES_UP) as client,
        pytest.raises(BadReply, match="answered with 302 Found, and not as a mapper does"),
    ):
        client.status()
    assert http_mapper.asked == []


def test_cookies_are_not_kept():
    server = Server(OK + b"Set-Cookie: a=b\r\nContent-Length: 2\r\nConnection: close\r\n\r\n{}")
    with serving(server) as url, MapClient(url, timeout=GIVES_UP) as client:
        assert client.quality() == client.quality() == {}
    assert len(server.requests) == 2
    assert b"cookie" not in server.requests[1].lower()


def test_what_a_stranger_says_steers_no_terminal(mapper, client):
    mapper.problem = {"type": "no\x1b[2J", "status": 404, "detail": "gone\n\x1b]0;x\x07\ud800" + "!" * 10_000}
    with pytest.raises(MapperError) as caught:
        client.status()
    assert str(caught.value).isprintable()
    assert caught.value.type == "no?[2J"
    assert caught.value.detail.startswith("gone ?]0;x??!!!")
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    "body",
    [
        b"[" * 100_000,
        b'{"a":' * 100_000,
        b'{"scans": ' + b"[" * 2000 + b"]" * 2000 + b"}",
        b"1" * 10_000,
        b'{"uptime_s": NaN}',
        b'{"uptime_s": -Infinity}',
        b"\xff\xfe\x00",
        b"",
        b"null",
    ],
)
@pytest.mark.parametrize("name", ["status", "quality", "cell"])
def test_what_is_no_json_object_is_a_bad_reply(mapper, client, name, body):
    mapper.bodies[name] = body
    ask = {"status": client.status, "quality": client.quality, "cell": lambda: client.cell(0, 0)}[name]
    with pytest.raises(BadReply, match=f"^{name}: ") as caught:
        ask()
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


def test_figures_have_a_limit_of_their_own(mapper, client):
    mapper.bodies["quality"] = b"{}".ljust(16 * 1024**2)
    assert client.quality() == {}
    mapper.bodies["quality"] += b" "
    with pytest.raises(BadReply, match="quality: longer than 16777216 bytes"):
        client.quality()


def test_a_refusal_has_a_limit_of_its_own(mapper, client):
    mapper.problem = {"type": "no", "status": 404, "detail": "x" * 65536}
    with pytest.raises(BadReply, match="longer than 65536 bytes"):
        client.status()


@pytest.mark.parametrize("problem", [{"type": "no", "status": True}, {"type": "no", "status": 10**400}])
def test_a_refusal_has_a_status_of_http_s(zenoh_mapper, problem):
    zenoh_mapper.problem = json.dumps(problem).encode()
    with (
        MapClient(zenoh_mapper.address, map_name="hall") as client,
        pytest.raises(BadReply, match="problem\\+json with type and status is needed"),
    ):
        client.status()


def test_a_payload_over_zenoh_that_is_too_long_is_refused(zenoh_mapper):
    zenoh_mapper.bodies["map.png"] = bytes(1001)
    with MapClient(zenoh_mapper.address, map_name="hall", timeout=GIVES_UP, max_bytes=1000) as client:
        with pytest.raises(BadReply, match=r"map\.png: longer than 1000 bytes"):
            client.fetch("map.png")
        zenoh_mapper.bodies["map.png"] = bytes(1000)
        assert client.fetch("map.png") == bytes(1000)


def test_what_goes_with_a_map_over_zenoh_has_a_limit(zenoh_mapper):
    zenoh_mapper.meta = {"more": "x" * 5000}
    with (
        MapClient(zenoh_mapper.address, map_name="hall", timeout=GIVES_UP) as client,
        pytest.raises(BadReply, match="what goes with the map: longer than 4096 bytes"),
    ):
        client.get_map()


@pytest.mark.parametrize("epoch", ["\x1b[2J", "läufer", "x" * 129, ...])
def test_an_epoch_is_a_plain_text(zenoh_mapper, epoch):
    """It goes into a header of the next request."""
    zenoh_mapper.meta = {"epoch": epoch}
    with (
        MapClient(zenoh_mapper.address, map_name="hall", timeout=GIVES_UP) as client,
        pytest.raises(BadReply, match="a plain text is needed as epoch") as caught,
    ):
        client.get_map()
    assert str(caught.value).isprintable()


def test_who_keeps_silent_does_not_hold_up_the_mapper_s_answer(listener, zenoh_mapper, eventually):
    held = []
    listener.declare_queryable("ogm/v1/hall/status", held.append)
    with MapClient(zenoh_mapper.address, map_name="hall", timeout=GIVES_UP) as client:
        began = time.monotonic()
        assert client.status().map == "hall"
        assert time.monotonic() - began < GIVES_UP
        eventually(lambda: held)  # it was asked, too, and has not answered
    held.clear()


def test_a_robot_s_feedback_has_the_same_limits(listener, zenoh_mapper):
    with RobotPublisher("r1", map_name="hall", session=listener) as robot:
        for body in (b"[" * 100_000, b"x" * (16 * 1024**2 + 1)):
            zenoh_mapper.bodies["status"] = body
            with pytest.raises(BadReply, match=r"^status: "):
                robot.feedback(GIVES_UP)


@pytest.mark.parametrize("max_bytes", [0, -1, 1.5, True, "1"])
def test_a_limit_that_is_none_is_refused(max_bytes):
    with pytest.raises(BadSetting, match="max_bytes: a positive whole number is needed"):
        MapClient("http://127.0.0.1:1", max_bytes=max_bytes)
