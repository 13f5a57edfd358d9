"""Sizes of HTTP requests: head and body are limited in bytes, whatever they say of themselves."""

import contextlib
import socket

import pytest

from http_desk import answer_from, get, http_desk

HEAD, BODY = 64 * 1024, 1024
IN_VAIN = 20_000_000
"""Bytes that the kernels' buffers on both sides hold, more or less, and the server discards."""
LONG = b"a" * 1_000_000
CLOSE = b"Connection: close"


@pytest.fixture(scope="module")
def desk():
    with http_desk() as desk:
        yield desk


def post(*headers, body=b"", path=b"/"):
    return get(path, *headers, method=b"POST") + body


def length(n):
    return b"Content-Length: %d" % n


def chunked(*chunks):
    frames = b"".join(b"%x\r\n%s\r\n" % (len(chunk), chunk) for chunk in (*chunks, b""))
    return post(b"Transfer-Encoding: chunked", CLOSE, body=frames)


@pytest.mark.parametrize("size", [HEAD, HEAD + 1])
@pytest.mark.parametrize("where", ["target", "value", "name", "many"])
def test_target_and_headers_have_64_kb(desk, where, size):
    fixed = len("/") + len("Host: a\r\n") + len("Connection: close\r\n")
    free = size - fixed
    path, extra = b"/", []
    if where == "target":
        path = b"/" + b"a" * (free if size <= HEAD else HEAD)
    elif where == "value":
        extra = [b"A: " + b"v" * (free - len("A: \r\n"))]
    elif where == "name":
        extra = [b"n" * (free - len(": v\r\n")) + b": v"]
    else:
        short = b"A: b"
        n, rest = divmod(free, len(short) + 2)
        extra = [short] * (n - 1) + [short + b"c" * rest]
    (answer,) = desk.say(get(path, *extra, CLOSE))
    if size <= HEAD:
        assert answer.status == 200
    elif where == "target":
        assert answer.problem() == (414, "uri-too-long")
    else:
        assert answer.problem() == (431, "headers-too-large")


@pytest.mark.parametrize(
    ("beginning", "filling", "status"),
    [
        (b"GET /", b"a", 414),
        (b"GET / HTTP/1.1\r\nA: ", b"a", 431),
        (b"GET / HTTP/1.1\r\n", b"A: b\r\n", 431),
        (b"", b"\r\n", 431),
    ],
)
def test_a_head_without_an_end_is_refused_once_it_is_too_long(desk, beginning, filling, status):
    (answer,) = desk.say(beginning + filling * (100_000 // len(filling)))
    assert answer.status == status


def test_a_url_of_100_mb_is_not_read_and_holds_nobody_up(desk):
    """Not timed: to read it all takes 20 s of the event loop; here most of it is sent in vain."""
    with desk.call() as sock, desk.call() as other, other.makefile("rb") as heard:

        def somebody_else_is_answered():
            other.sendall(get(b"/between"))
            assert answer_from(heard).status == 200

        sock.sendall(b"GET /")
        assert sent_until_cut_off(sock, 100_000_000, somebody_else_is_answered) < IN_VAIN


def sent_until_cut_off(sock, limit, between=lambda: None):
    """How many bytes a client gets rid of, of so many."""
    sent = 0
    with contextlib.suppress(ConnectionResetError, BrokenPipeError):
        while sent < limit:
            sock.sendall(LONG)
            sent += len(LONG)
            between()
    return sent


@pytest.mark.parametrize("path", [b"/", b"/reset", b"/nowhere"])
@pytest.mark.parametrize("method", [b"POST", b"GET", b"PUT", b"DELETE", b"PATCH", b"OPTIONS"])
def test_a_body_has_1_kb(desk, path, method):
    desk.seen.clear()
    fits, over = b"b" * BODY, b"b" * (BODY + 1)
    (answer,) = desk.say(get(path, length(len(fits)), CLOSE, method=method) + fits)
    assert (answer.status, answer.body) == (200, b"said " + fits)
    (answer,) = desk.say(get(path, length(len(over)), method=method) + over)
    assert answer.problem() == (413, "content-too-large")
    assert len(desk.seen) == 1  # nothing was begun


def test_a_body_in_chunks_has_1_kb(desk):
    desk.seen.clear()
    (answer,) = desk.say(chunked(*[b"c"] * BODY))
    assert (answer.status, answer.body) == (200, b"said " + b"c" * BODY)
    for chunks in ([b"c"] * (BODY + 1), [b"c" * (BODY + 1)], [LONG] * 3):
        (answer,) = desk.say(chunked(*chunks))
        assert answer.problem() == (413, "content-too-large")
    endless = post(b"Transfer-Encoding: chunked", body=b"1;" + b"e" * 200_000)
    (answer,) = desk.say(endless)
    assert answer.status == 413
    assert len(desk.seen) == 1


def test_what_is_announced_is_refused_before_it_comes(desk):
    for announced in (BODY + 1, 10**9, 2**63):
        (answer,) = desk.say(post(length(announced)))
        assert answer.status == 413


def test_a_length_that_is_too_short_leaves_the_rest_to_be_a_bad_request(desk):
    desk.seen.clear()
    (answer,) = desk.say(post(length(3), body=b"abc" + b"d" * 5000))
    assert (answer.status, answer.body) == (200, b"said abc")
    assert desk.seen == [("POST", "/", b"abc")]


def test_a_length_that_is_too_long_begins_nothing(desk):
    desk.seen.clear()
    with desk.call() as sock:
        sock.sendall(post(length(10), body=b"abc"))
        sock.shutdown(socket.SHUT_WR)
        assert sock.recv(1) == b""
    assert desk.seen == []


def test_a_body_without_a_length_is_none(desk):
    """It is the begin of the next request, and a bad one."""
    desk.seen.clear()
    desk.say(post(CLOSE, body=b"b" * 5000))
    assert desk.seen == [("POST", "/", b"")]


def test_a_refused_body_is_not_read_to_its_end(desk):
    with desk.call() as sock:
        sock.sendall(post(length(10**9)))
        assert sent_until_cut_off(sock, 100_000_000) < IN_VAIN


def test_a_client_that_asks_before_it_sends_is_told_to(desk):
    with desk.call() as sock, sock.makefile("rb") as file:
        sock.sendall(post(length(3), b"Expect: 100-continue"))
        assert answer_from(file).status == 100
        sock.sendall(b"abc")
        assert answer_from(file).body == b"said abc"
        sock.sendall(post(length(BODY + 1), b"Expect: 100-continue"))
        assert answer_from(file).status == 413


def test_trailers_do_not_pass_for_headers(desk):
    body = b"3\r\nabc\r\n0\r\nHost: evil\r\nX: y\r\n\r\n"
    (answer,) = desk.say(post(b"Transfer-Encoding: chunked", CLOSE, body=body))
    assert (answer.body, answer.headers["heard"]) == (b"said abc", "")
    (answer,) = desk.say(post(b"Transfer-Encoding: chunked", CLOSE, b"X: z", body=body))
    assert answer.headers["heard"] == "z"


def test_a_mapper_is_not_reset_by_a_request_that_is_too_long_or_never_whole(mapper):
    before, address = mapper.status()["epoch"], (mapper.http.base_url.host, mapper.http.base_url.port)
    response = mapper.http.post("/reset", content=b"b" * (BODY + 1))
    assert (response.status_code, response.json()["type"]) == (413, "content-too-large")
    chunks = (b"c" for _ in range(BODY + 1))
    assert mapper.http.post("/reset", content=chunks).status_code == 413
    with socket.create_connection(address) as sock:
        sock.sendall(post(length(10), body=b"abc", path=b"/reset"))
        sock.shutdown(socket.SHUT_WR)
        assert sock.recv(1) == b""
    assert mapper.status()["epoch"] == before
    assert mapper.http.post("/reset", content=b"b" * BODY).status_code == 200
    assert mapper.status()["epoch"] != before
