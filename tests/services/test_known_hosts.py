"""Host check: a page whose own name was made to lead to the mapper neither reads nor writes."""

import asyncio
import socket

import pytest

MINE = socket.gethostname()
KNOWN = [
    *(
        "127.0.0.1",
        "127.0.0.1:8000",
        "127.0.0.1:80",
        "192.168.1.7:9999",
        "[::1]",
        "[::1]:8000",
        "[2001:db8::7]:80",
    ),
    *("localhost", "localhost:8000", "LocalHost", "localhost.", "LOCALHOST.:8000", "map.localhost:8000"),
    *(MINE, f"{MINE.upper()}:8000", f"{MINE}.:8000", f"{MINE}.local:8000"),
    *("map.example", "Map.Example:443", "map.example."),
]
FOREIGN = [
    *(
        "evil.example",
        "evil.example:8000",
        "localhost.evil.example",
        "127.0.0.1.evil.example",
        "evil-localhost",
    ),
    *(
        "sub.map.example",
        "map.example.evil",
        "example",
        "1.2.3",
        "127.1",
        "0x7f.0.0.1",
        "2130706433",
        "127.0.0.01",
    ),
    *("[::1", "::1", "localhost..", ".localhost.evil", "[127.0.0.1].evil"),
]
BROKEN = [
    *(
        "",
        ":8000",
        "localhost:",
        "localhost:x",
        "localhost:-1",
        "localhost:65536",
        "localhost:8000:8000",
    ),
    *(
        "user@localhost",
        "localhost@evil.example",
        "user:pass@127.0.0.1",
        "localhost/",
        "localhost?",
        "http://localhost",
    ),
    *(
        "localhost, evil.example",
        "local host",
        "löcalhost",
        "[::1%25lo]",
        "localhost:٣",
        "localhost#",
        "a" * 9 + "\x7f",
    ),
]


@pytest.fixture(scope="module")
def named(start_mapper):
    """A mapper that goes by the name map.example, too, with a map that is ready to be sent."""
    with start_mapper(map={"resolution": 0.5}, http={"hosts": ["MAP.example"]}) as mapper:
        mapper.draw_cross()
        mapper.http.get("/map.png").raise_for_status()
        yield mapper


def ask(mapper, host, method="GET", path="/status"):
    return mapper.http.request(method, path, headers={"Host": host.encode()})


@pytest.mark.parametrize("host", KNOWN)
def test_its_own_names_are_known(named, host):
    assert ask(named, host).status_code == 200
    assert ask(named, host, path="/map.png").status_code == 200


@pytest.mark.parametrize(
    "path", ["/status", "/map.png", "/", "/livez", "/docs", "/openapi.json", "/nowhere", "/reset"]
)
def test_no_route_answers_to_another_name(named, path):
    before = named.status()["epoch"]
    for method in ("GET", "HEAD", "POST", "OPTIONS", "DELETE"):
        response = ask(named, "evil.example:8000", method, path)
        assert response.status_code == 421
        assert response.headers["content-type"] == "application/problem+json"
        assert response.headers["cache-control"] == "no-store"
        if method != "HEAD":
            body = response.json()
            assert (body["type"], body["title"]) == ("misdirected", "Misdirected Request")
            assert body["detail"].startswith("Host 'evil.example:8000': this mapper does not go by that name")
            assert "http.hosts" in body["detail"]
    assert named.status()["epoch"] == before


@pytest.mark.parametrize("host", FOREIGN)
def test_other_names_are_refused(named, host):
    assert ask(named, host).status_code in (400, 421)
    assert ask(named, host, path="/map.png").status_code in (400, 421)


@pytest.mark.parametrize("host", BROKEN)
def test_what_is_no_host_is_refused(named, host):
    assert ask(named, host).status_code == 400


def test_a_long_one_is_not_repeated(named):
    assert len(ask(named, "x" * 10_000).content) < 1000


def test_every_host_that_is_given_must_be_known(named):
    """The parser lets no second one through; the check does not rely on that."""
    middleware = named.service._http_thread._server.config.app

    async def ask_twice():
        sent = []
        scope = {
            "type": "http",
            "method": "GET",
            "path": "/status",
            "raw_path": b"/status",
            "query_string": b"",
        }
        scope |= {"headers": [(b"host", b"localhost"), (b"host", b"evil.example")], "http_version": "1.1"}

        async def send(message):
            sent.append(message)

        await middleware(scope, None, send)
        return sent[0]["status"]

    assert asyncio.run(ask_twice()) == 421


def test_the_name_that_it_is_served_on_is_known(start_mapper, monkeypatch):
    resolve = socket.getaddrinfo

    def resolving(host, *rest, **named):
        return resolve("127.0.0.1" if host == "mapper.lan" else host, *rest, **named)

    monkeypatch.setattr(socket, "getaddrinfo", resolving)
    with start_mapper(http={"host": "mapper.lan"}) as mapper:
        assert ask(mapper, "mapper.lan:1").status_code == 200
        assert ask(mapper, "other.lan:1").status_code == 421
