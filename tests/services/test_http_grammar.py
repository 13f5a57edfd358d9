"""Grammar of HTTP requests: what is not quite HTTP/1.1 is answered with a problem, and reaches nobody."""

import pytest

from http_desk import answer_from, get, http_desk

LINE = b"GET / HTTP/1.1\r\n"
HOST = b"Host: a\r\n"
POST = b"POST / HTTP/1.1\r\n" + HOST
END = b"\r\n"

BAD = {
    "no host": LINE + END,
    "host twice": LINE + HOST + HOST + END,
    "two hosts": LINE + HOST + b"hOsT: b\r\n" + END,
    "two hosts in 1.0": b"GET / HTTP/1.0\r\n" + HOST + HOST + END,
    "no version": b"GET /\r\n\r\n",
    "a later version": b"GET / HTTP/2.0\r\n" + HOST + END,
    "HTTP/2": b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "no such version": b"GET / HTTP/1.2\r\n" + HOST + END,
    "no method": b"/ HTTP/1.1\r\n" + HOST + END,
    "another's method": b"FETCH / HTTP/1.1\r\n" + HOST + END,
    "TLS": b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    "noise": b"\x00\xff" * 100,
    "an absolute target": b"GET http://a/ HTTP/1.1\r\n" + HOST + END,
    "a target of another host": b"GET http://b/reset HTTP/1.1\r\n" + HOST + END,
    "a relative target": b"GET map.png HTTP/1.1\r\n" + HOST + END,
    "an authority": b"CONNECT a:80 HTTP/1.1\r\n" + HOST + END,
    "an asterisk": b"OPTIONS * HTTP/1.1\r\n" + HOST + END,
    "a fragment": b"GET /#x HTTP/1.1\r\n" + HOST + END,
    "NUL in the target": b"GET /\0 HTTP/1.1\r\n" + HOST + END,
    "a target that is not ASCII": "GET /ü HTTP/1.1\r\n".encode() + HOST + END,
    "a query that is not ASCII": "GET /?ü HTTP/1.1\r\n".encode() + HOST + END,
    "NUL in a header": LINE + HOST + b"A: b\0c\r\n" + END,
    "a folded line": LINE + HOST + b"A: b\r\n c\r\n" + END,
    "a first line that is folded": LINE + b" A: b\r\n" + HOST + END,
    "CR in a header": LINE + HOST + b"A: b\rC: d\r\n" + END,
    "LF in a header": LINE + HOST + b"A: b\nC: d\r\n" + END,
    "lines that end with LF": b"GET / HTTP/1.1\nHost: a\n\n",
    "a space before the colon": LINE + b"Host : a\r\n" + END,
    "no colon": LINE + HOST + b"A\r\n" + END,
    "no name": LINE + HOST + b": b\r\n" + END,
    "a name that is none": LINE + HOST + b"A(: b\r\n" + END,
    "length and chunks": POST + b"Content-Length: 5\r\nTransfer-Encoding: chunked\r\n" + END + b"0\r\n\r\n",
    "chunks and length": POST + b"Transfer-Encoding: chunked\r\nContent-Length: 5\r\n" + END + b"0\r\n\r\n",
    "two lengths": POST + b"Content-Length: 3\r\nContent-Length: 4\r\n" + END + b"abcd",
    "one length twice": POST + b"Content-Length: 3\r\nContent-Length: 3\r\n" + END + b"abc",
    "a list of lengths": POST + b"Content-Length: 3, 3\r\n" + END + b"abc",
    "a signed length": POST + b"Content-Length: +3\r\n" + END + b"abc",
    "a negative length": POST + b"Content-Length: -3\r\n" + END + b"abc",
    "a length beyond 64 bits": POST + b"Content-Length: 18446744073709551617\r\n" + END + b"a",
    "gzip": POST + b"Transfer-Encoding: gzip, chunked\r\n" + END + b"0\r\n\r\n",
    "chunks twice": POST + b"Transfer-Encoding: chunked, chunked\r\n" + END + b"0\r\n\r\n",
    "nearly chunked": POST + b"Transfer-Encoding: xchunked\r\n" + END + b"0\r\n\r\n",
    "chunks in 1.0": b"POST / HTTP/1.0\r\nTransfer-Encoding: chunked\r\n" + END + b"0\r\n\r\n",
    "a chunk without a size": POST + b"Transfer-Encoding: chunked\r\n" + END + b"zz\r\nabc\r\n0\r\n\r\n",
    "a chunk that is longer": POST + b"Transfer-Encoding: chunked\r\n" + END + b"3\r\nabcd\r\n0\r\n\r\n",
}


@pytest.fixture(scope="module")
def desk():
    with http_desk() as desk:
        yield desk


@pytest.mark.parametrize("request_", BAD.values(), ids=BAD)
def test_what_is_not_http_is_refused(desk, request_, no_errors):
    desk.seen.clear()
    (answer,) = desk.say(request_)
    assert answer.problem() == (400, "bad-request")
    assert desk.seen == []


@pytest.mark.parametrize("at", [1, 7, 20])
def test_it_does_not_matter_where_a_request_is_cut(desk, at):
    good = b"POST /x?y HTTP/1.1\r\nHost: a\r\nContent-Length: 3\r\nConnection: close\r\n\r\nabc"
    (answer,) = desk.say(*(good[i : i + at] for i in range(0, len(good), at)))
    assert (answer.status, answer.body) == (200, b"said abc")
    bad = LINE + HOST + HOST + END
    (answer,) = desk.say(*(bad[i : i + at] for i in range(0, len(bad), at)))
    assert answer.status == 400


def test_http_1_0_may_lack_a_host(desk):
    (answer,) = desk.say(b"GET / HTTP/1.0\r\n\r\n")
    assert answer.status == 200


def test_connections_are_kept_unless_the_client_says_otherwise(desk):
    assert [answer.status for answer in desk.say(get() + get() + get(b"/", b"Connection: close"))] == [
        200
    ] * 3


def test_nothing_is_smuggled_behind_the_last_request(desk):
    desk.seen.clear()
    assert len(desk.say(get(b"/first", b"Connection: close") + get(b"/second"))) == 1
    assert [path for _, path, _ in desk.seen] == ["/first"]


def test_an_answer_that_is_under_way_is_not_torn_by_what_follows(desk):
    """The good request's answer is whole, and the bad one behind it ends the connection."""
    answers = desk.say(get(b"/good") + b"nonsense\r\n\r\n")
    assert [(answer.status, answer.body) for answer in answers] == [(200, b"said ")]
    desk.seen.clear()
    assert len(desk.say(get(b"/one") + get(b"/two") + LINE + END)) == 2
    assert [path for _, path, _ in desk.seen] == ["/one", "/two"]


def test_requests_do_not_pile_up_behind_an_answer(desk):
    """The first, 16 that wait for it, and no more, although 1,000 came in one piece."""
    answers = desk.say(get() * 1000)
    assert [answer.status for answer in answers] == [200] * 17


@pytest.mark.parametrize("protocol", [b"websocket", b"h2c", b"anything"])
def test_an_upgrade_is_not_taken_up(desk, protocol, no_errors):
    headers = b"Connection: Upgrade", b"Upgrade: " + protocol, b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    (answer,) = desk.say(get(b"/", *headers, b"Sec-WebSocket-Version: 13") + b"\x81\x05hello")
    assert (answer.status, answer.body, answer.headers["connection"]) == (200, b"said ", "close")
    assert [record.getMessage() for record in no_errors.records] == []


def test_a_flood_of_nonsense_is_a_line_a_second(caplog):
    with http_desk() as desk:
        for _ in range(50):
            desk.say(b"nonsense\r\n\r\n")
    lines = [record.getMessage() for record in caplog.records]
    assert 0 < len(lines) < 50
    assert all(line.startswith("HTTP: a request is refused: ") for line in lines)


def test_whoever_breaks_off_harms_nobody(desk, no_errors):
    for said in (b"", b"GET", LINE, LINE + HOST, get(b"/big")):
        with desk.call() as sock:
            sock.sendall(said)
    with desk.call() as sock, sock.makefile("rb") as file:
        sock.sendall(get())
        assert answer_from(file).status == 200
