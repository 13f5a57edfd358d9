"""WebSocket connections from the socket up: what becomes one, what the application sees of it, its end."""

import os
import socket
import struct
from contextlib import ExitStack, contextmanager, suppress

import pytest

from http_desk import BIG, HANDSHAKE, answer_from, get, http_desk

TEXT, BINARY, CLOSE, PING, PONG = 0x1, 0x2, 0x8, 0x9, 0xA
REST = 0x0
"""The opcode of all frames of a message but the first."""
MAX_MESSAGE = 65536
NEVER = 3600.0


def frame(opcode, payload=b"", *, last=True, masked=True, reserved=0):
    """A client's frame (RFC 6455, section 5.2); its mask is of noughts."""
    mask = 0x80 if masked else 0
    head = bytes([(0x80 if last else 0) | reserved | opcode])
    if len(payload) < 126:
        head += bytes([mask | len(payload)])
    elif len(payload) < 65536:
        head += struct.pack("!BH", mask | 126, len(payload))
    else:
        head += struct.pack("!BQ", mask | 127, len(payload))
    return head + bytes(4 * masked) + payload


def frame_from(file):
    """The next frame of a server: its opcode and payload; None at the end."""
    head = file.read(2)
    if len(head) < 2:
        return None
    assert head[0] & 0x70 == 0, "no extension was agreed on"
    size = head[1]
    if size > 125:
        (size,) = struct.unpack(*(("!H", file.read(2)) if size == 126 else ("!Q", file.read(8))))
    return head[0] & 0xF, file.read(size)


def closing(code, reason=b""):
    return struct.pack("!H", code) + reason


@pytest.fixture
def desk():
    with http_desk(stall_time=1.0, request_time=NEVER) as desk:
        yield desk


@contextmanager
def opened(desk, *headers, path=b"/ws", before=b""):
    """A WebSocket: a socket, and a file to read it from."""
    with desk.call() as sock, sock.makefile("rb") as file:
        if before:
            sock.sendall(before)
            assert answer_from(file).status == 200
        sock.sendall(get(path, *HANDSHAKE, *headers))
        assert answer_from(file).status == 101
        yield sock, file


class TestHandshake:
    def test_a_websocket_is_opened(self, desk, no_errors):
        with desk.call() as sock, sock.makefile("rb") as file:
            sock.sendall(get(b"/ws", *HANDSHAKE, b"Sec-WebSocket-Extensions: permessage-deflate"))
            answer = answer_from(file)
            assert answer.status == 101
            assert answer.headers["sec-websocket-accept"] == "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="  # RFC 6455, 1.3
            assert "sec-websocket-extensions" not in answer.headers
            sock.sendall(frame(BINARY, b"hello"))
            assert frame_from(file) == (BINARY, b"hello")
        assert [record.getMessage() for record in no_errors.records] == []

    def test_after_other_requests_on_the_same_connection(self, desk):
        with opened(desk, before=get(b"/one")) as (sock, file):
            sock.sendall(frame(BINARY, b"hello"))
            assert frame_from(file) == (BINARY, b"hello")

    def test_behind_one_that_is_not_answered_yet_it_is_an_ordinary_request(self, desk):
        with desk.call() as sock, sock.makefile("rb") as file:
            sock.sendall(get(b"/one") + get(b"/ws", *HANDSHAKE))
            assert [answer_from(file).status, answer_from(file).status] == [200, 200]
        assert [path for _, path, _ in desk.seen] == ["/one", "/ws"]

    def test_below_another_path_and_with_a_query(self, desk):
        with opened(desk, path=b"/maps/hall/ws?a=1") as (sock, file):
            sock.sendall(frame(BINARY, b"hello"))
            assert frame_from(file) == (BINARY, b"hello")
        assert desk.seen == [("WebSocket", "/maps/hall/ws", b"hello")]

    @pytest.mark.parametrize(
        "path", [b"/h\xc3\xa4ll/ws", b"/ws?h\xff", b"/%ff/ws", b"/ws?%", b"//ws", b"/../ws"]
    )
    def test_odd_paths_harm_nobody(self, desk, path, no_errors):
        with desk.call() as sock, sock.makefile("rb") as file:
            sock.sendall(get(path, *HANDSHAKE))
            assert answer_from(file).status in (101, 400)

    def test_what_comes_with_it_is_not_lost(self, desk):
        with desk.call() as sock, sock.makefile("rb") as file:
            sock.sendall(get(b"/ws", *HANDSHAKE) + frame(BINARY, b"one") + frame(BINARY, b"two"))
            assert answer_from(file).status == 101
            assert [frame_from(file), frame_from(file)] == [(BINARY, b"one"), (BINARY, b"two")]

    def test_byte_by_byte(self, desk):
        with desk.call() as sock, sock.makefile("rb") as file:
            for byte in get(b"/ws", *HANDSHAKE):
                sock.sendall(bytes([byte]))
            assert answer_from(file).status == 101

    @pytest.mark.parametrize(
        "request_",
        [
            get(b"/ws", *HANDSHAKE[:2], HANDSHAKE[3]),
            get(b"/ws", *HANDSHAKE, HANDSHAKE[2]),
            get(b"/ws", *HANDSHAKE[:2], b"Sec-WebSocket-Key: short", HANDSHAKE[3]),
            get(b"/ws", *HANDSHAKE[:3], b"Sec-WebSocket-Version: 8"),
            get(b"/ws", HANDSHAKE[0], b"Upgrade: h2c", *HANDSHAKE[2:]),
            get(b"/ws", *HANDSHAKE[1:]),
            get(b"/ws", *HANDSHAKE, method=b"HEAD"),
            get(b"/ws", *HANDSHAKE).replace(b"HTTP/1.1", b"HTTP/1.0"),
            get(b"/ws", *HANDSHAKE, b"Origin: http://a", b"Origin: http://evil.example"),
            get(b"/ws", *HANDSHAKE, b"Sec-WebSocket-Protocol: a,,b"),
            get(b"/wss", *HANDSHAKE),
            get(b"/ws", *HANDSHAKE, b"Content-Length: 3") + b"abc",
        ],
        ids=[
            "no key",
            "two keys",
            "short key",
            "version",
            "h2c",
            "no connection",
            "HEAD",
            "1.0",
            "two origins",
            "subprotocols",
            "path",
            "body",
        ],
    )
    def test_what_is_no_handshake_is_an_ordinary_request(self, desk, request_):
        with desk.call() as sock, sock.makefile("rb") as file:
            sock.sendall(request_)
            assert file.readline().split()[1] == b"200"
        assert [path for _, path, _ in desk.seen] == [request_.split()[1].decode()]

    @pytest.mark.parametrize(
        "headers", [[b"X: " + b"y" * 9000], [b"X: y"] * 200], ids=["a long one", "many of them"]
    )
    def test_headers_that_are_too_much_for_it_are_said_to_be(self, desk, headers, eventually):
        (answer,) = desk.say(get(b"/ws", *HANDSHAKE, *headers))
        assert answer.problem() == (431, "headers-too-large")
        assert desk.closed == ["headers-too-large"]
        eventually(lambda: desk.connections() == 0)

    def test_it_counts_as_a_connection(self, desk, eventually):
        with opened(desk), opened(desk):
            assert desk.connections() == 2
        eventually(lambda: desk.connections() == 0)

    def test_it_is_not_closed_for_waiting(self):
        with http_desk(request_time=0.2) as desk, opened(desk) as (sock, file):
            with desk.call() as idle:
                assert idle.recv(1) == b""  # who waits for a request for as long is
            sock.sendall(frame(BINARY, b"hello"))
            assert frame_from(file) == (BINARY, b"hello")


class TestMessages:
    def test_a_message_in_many_frames_is_one(self, desk):
        with opened(desk) as (sock, file):
            for part in (frame(BINARY, b"a", last=False), frame(REST, b"b", last=False), frame(PING, b"p")):
                sock.sendall(part)
            assert frame_from(file) == (PONG, b"p")
            sock.sendall(frame(REST, b"c"))
            assert frame_from(file) == (BINARY, b"abc")

    def test_a_long_one_is_as_long_as_it_may_be(self, desk):
        with opened(desk) as (sock, file):
            longest = os.urandom(MAX_MESSAGE)
            sock.sendall(frame(BINARY, longest))
            assert frame_from(file) == (BINARY, longest)

    @pytest.mark.parametrize(
        ("said", "code"),
        [
            ([frame(BINARY, bytes(MAX_MESSAGE + 1))], 1009),
            ([frame(BINARY, bytes(40000), last=False), frame(REST, bytes(40000))], 1009),
            ([frame(BINARY, last=False)] + [frame(REST, last=False)] * 256, 1009),
            ([frame(TEXT, b"a", last=False)] + [frame(REST, b"a", last=False)] * 256, 1009),
            ([frame(PONG) * 2000], 1008),
            ([frame(BINARY, b"a", masked=False)], 1002),
            ([frame(0x3, b"a")], 1002),
            ([frame(BINARY, b"a", reserved=0x40)], 1002),
            ([frame(REST, b"a")], 1002),
            ([frame(PING, bytes(126))], 1002),
            ([b"\xff" * 300], 1002),
        ],
        ids=[
            "too long",
            "too long in parts",
            "parts of nothing",
            "texts in parts",
            "too many at once",
            "no mask",
            "opcode",
            "reserved",
            "no begin",
            "ping",
            "noise",
        ],
    )
    def test_what_is_no_message_ends_it_with_a_reason(self, desk, said, code, no_errors):
        with opened(desk) as (sock, file):
            for part in said:
                sock.sendall(part)
            opcode, payload = frame_from(file)
            assert (opcode, payload[:2]) == (CLOSE, closing(code))
            with suppress(ConnectionResetError):  # it has not read the rest
                assert frame_from(file) is None
        assert desk.seen == []

    @pytest.mark.parametrize(
        ("said", "code"),
        [(frame(0x3), 1002), (frame(BINARY, bytes(70000)), 1009), (frame(PONG) * 2000, 1008)],
    )
    def test_nor_does_what_comes_before_it_has_begun(self, desk, said, code, no_errors, eventually):
        with desk.call() as sock, sock.makefile("rb") as file:
            sock.sendall(get(b"/ws", *HANDSHAKE) + said)
            assert answer_from(file).status == 101
            assert frame_from(file)[1][:2] == closing(code)
            eventually(lambda: desk.connections() == 0)

    def test_who_sends_many_frames_keeps_nobody_waiting(self, desk, eventually):
        with ExitStack() as stack:
            many = [stack.enter_context(opened(desk))[0] for _ in range(8)]
            for sock in many:
                with suppress(ConnectionResetError, BrokenPipeError):
                    sock.sendall(frame(PONG) * 100_000)
            eventually(lambda: desk.connections() == 0)
        with opened(desk) as (sock, file):
            sock.sendall(frame(BINARY, b"a") * 1000)
            assert [frame_from(file) for _ in range(1000)] == [(BINARY, b"a")] * 1000

    def test_texts_are_not_looked_into(self, desk, no_errors):
        """The application is told that there is one: no bytes of a stranger make a decoder fail."""
        with opened(desk) as (sock, file):
            for part in (frame(TEXT, b"\xff\xfe"), frame(TEXT, b"\xff", last=False), frame(REST, b"\xfe")):
                sock.sendall(part)
            assert [frame_from(file), frame_from(file)] == [(BINARY, b"a text")] * 2
            sock.sendall(frame(BINARY, b"hello"))
            assert frame_from(file) == (BINARY, b"hello")
        assert [said for *_, said in desk.seen] == ["", "", b"hello"]

    def test_who_closes_is_answered(self, desk, eventually):
        with opened(desk) as (sock, file):
            sock.sendall(frame(CLOSE, closing(1000, b"done")))
            assert frame_from(file) == (CLOSE, closing(1000, b"done"))
            assert frame_from(file) is None
        eventually(lambda: desk.connections() == 0)
        assert desk.closed == []


class TestSlowClients:
    def test_who_does_not_read_is_cut_off(self, desk, eventually):
        with opened(desk) as (sock, _):
            sock.sendall(frame(BINARY))
            eventually(lambda: desk.seen)
            eventually(lambda: desk.connections() == 0)
        assert set(desk.closed) == {"stalled"}

    def test_without_the_kernels_help_too(self, eventually, monkeypatch):
        monkeypatch.delattr(socket, "TCP_USER_TIMEOUT")  # other systems than Linux have none
        with http_desk(stall_time=1.0, request_time=NEVER) as desk, opened(desk) as (sock, _):
            sock.sendall(frame(BINARY))
            eventually(lambda: desk.seen)
            eventually(lambda: desk.connections() == 0)
            assert desk.closed == ["stalled"]
            assert desk.sent == []

    def test_a_message_counts_as_sent_when_it_has_gone(self, eventually):
        with http_desk(stall_time=NEVER) as desk, opened(desk) as (sock, file):
            sock.sendall(frame(BINARY))
            assert len(file.read(2 + 8 + BIG // 2)) == 10 + BIG // 2
            assert desk.sent == []
            assert len(file.read(BIG // 2)) == BIG // 2
            eventually(lambda: desk.sent == [BIG])

    def test_who_answers_no_ping_is_gone(self, eventually, monkeypatch):
        monkeypatch.setattr("ogm_services.mapper.serving.http_server.PING_PERIOD", 1.0)
        with http_desk(request_time=NEVER) as desk, opened(desk) as (sock, file), opened(desk) as (_, silent):
            for _ in range(2):
                opcode, payload = frame_from(file)
                assert opcode == PING
                sock.sendall(frame(PONG, payload))
            assert frame_from(silent)[0] == PING
            assert frame_from(silent) == (CLOSE, closing(1011, b"keepalive ping timeout"))
            eventually(lambda: desk.connections() <= 1)

    def test_who_reads_slowly_gets_everything(self):
        with http_desk(stall_time=30.0) as desk, opened(desk) as (sock, file):
            sock.sendall(frame(BINARY))
            assert frame_from(file) == (BINARY, bytes(BIG))

    def test_answers_to_pings_do_not_pile_up(self, eventually, monkeypatch):
        monkeypatch.setattr("ogm_services.mapper.serving.websocket_connection.MOST_AT_ONCE", 10**6)
        with http_desk(stall_time=NEVER, request_time=NEVER) as desk, opened(desk) as (sock, _):
            pings = frame(PING, bytes(125)) * 5000

            def cut_off():
                try:
                    sock.sendall(pings)
                except (ConnectionResetError, BrokenPipeError, TimeoutError):
                    return True
                return False

            sock.settimeout(1.0)
            eventually(cut_off)
            eventually(lambda: desk.connections() == 0)
            assert desk.closed == ["stalled"]

    def test_when_the_server_stops_all_are_told_and_none_is_waited_for(self, no_errors):
        """The one that does not read, too: uvicorn would wait for it."""
        with http_desk(stall_time=NEVER, request_time=NEVER) as desk:
            stuck = desk.call()
            well = opened(desk)
            sock, file = well.__enter__()
            stuck_sock = stuck.__enter__()
            stuck_sock.sendall(get(b"/ws", *HANDSHAKE) + frame(BINARY))
            sock.sendall(frame(BINARY, b"hello"))
            assert frame_from(file) == (BINARY, b"hello")
        assert frame_from(file) == (CLOSE, closing(1001, b"the mapper stops"))
        assert frame_from(file) is None
        well.__exit__(None, None, None)
        stuck.__exit__(None, None, None)
