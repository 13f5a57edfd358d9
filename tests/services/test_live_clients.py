"""WebSocket clients of a running mapper: who is let in, what each is told, and that none costs the others."""

import json
import os
import re
import socket
import time
from contextlib import ExitStack, contextmanager

import msgpack
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from ogm_services.replies.answer import Busy

AROUND = [-1, -1, 0, 0]
"""The four tiles around the anchor."""
SETTLED = 30.0


class Client:
    """A client that has been greeted; what it is sent, its tiles noted."""

    def __init__(self, socket):
        self.socket = socket
        self.hello = msgpack.unpackb(socket.recv(SETTLED))
        self.tiles = {}

    def view(self, tiles=AROUND, z=16, **fields):
        self.socket.send(msgpack.packb({"type": "view", "z": z, "tiles": tiles, **fields}))

    def next(self):
        message = msgpack.unpackb(self.socket.recv(SETTLED))
        for z, x, y, revision, png in message["tiles"]:
            self.tiles[z, x, y] = revision, png
        return message

    def until(self, condition):
        """The first message of which that is true."""
        deadline = time.monotonic() + SETTLED
        while not condition(message := self.next()):
            assert time.monotonic() < deadline, message
        return message

    def closed(self):
        """The code and the reason with which the mapper closes, once it does."""
        with pytest.raises(ConnectionClosed) as end:
            self.until(lambda _: False)
        return end.value.rcvd.code, end.value.rcvd.reason


@contextmanager
def client_of(mapper, headers=None, buffer=None, host=None, path="/ws"):
    """`buffer`: bytes that it may be sent ahead of what it reads, about; `host`: what it takes it for."""
    url = mapper.http.base_url.copy_with(scheme="ws", path=path)
    with socket.socket() as sock:
        if buffer is not None:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer)
        sock.connect((url.host, url.port))
        options = {"max_queue": 1, "max_size": 2**23, "ping_interval": None, "compression": None}
        name = str(url.copy_with(host=host or url.host))
        with connect(name, sock=sock, additional_headers=headers, **options) as connected:
            yield Client(connected)


def refusal(mapper, headers=None, **where):
    """Status and type with which a client is not let in."""
    with pytest.raises(InvalidStatus) as refused, client_of(mapper, headers, **where):
        pass
    answer = refused.value.response
    assert answer.headers["Content-Type"] == "application/problem+json"
    assert answer.headers["Cache-Control"] == "no-store"
    return answer.status_code, json.loads(answer.body)["type"]


def metric(mapper, name):
    text = mapper.http.get("/metrics").text
    return float(re.search(rf"^{re.escape(name)} (\S+)$", text, re.MULTILINE)[1])


def live(mapper):
    return metric(mapper, 'ogm_live_clients{map="hall"}')


def ended(mapper, reason):
    return metric(mapper, f'ogm_live_clients_ended_total{{map="hall",reason="{reason}"}}')


def fetched(mapper, tile, **query):
    z, x, y = tile
    answer = mapper.http.get(f"/tiles/{z}/{x}/{y}.png", params=query).raise_for_status()
    return int(answer.headers["OGM-Revision"]), answer.content


def check(mapper, client, **query):
    """What it holds is what HTTP serves, byte for byte."""
    assert client.tiles
    for tile, held in client.tiles.items():
        assert held == fetched(mapper, tile, **query), tile


def test_hello_says_which_map_it_is(cross):
    described = cross.http.get("/tiles.json").json()
    with client_of(cross) as client:
        assert client.hello == {
            "type": "hello",
            "protocol": 1,
            "map": "hall",
            **{name: described["ogm"][name] for name in ("epoch", "run", "revision", "resolution", "anchor")},
            "minzoom": described["minzoom"],
            "maxzoom": described["maxzoom"],
            "extent": described["ogm"]["extent"],
        }


@pytest.mark.parametrize(("z", "palette"), [(16, "ros"), (16, "dark"), (14, "ros"), (10, "cividis")])
def test_pushed_tiles_are_those_of_http_byte_for_byte(cross, z, palette):
    with client_of(cross) as client:
        client.view(z=z, palette=palette)
        update = client.next()
        assert (update["revision"], update["more"]) == (3, False)
        assert len(update["tiles"]) == 3  # south-west nothing is known
        check(cross, client, palette=palette)
        assert client.next()["tiles"] == []  # a second later


def test_changes_come_as_they_are_made(mapper):
    mapper.draw_cross()
    with client_of(mapper) as client:
        client.view(rate=20, scans=True)
        client.next()
        for n in range(10):
            mapper.scan([1.0], pose=[0.25 * n, 0.0, 0.0], at=10 + n)
            update = client.until(lambda message, n=n: message["revision"] == 4 + n)
            assert update["scans"]["r/s"]["pose"] == [0.25 * n, 0.0, 0.0]
            assert update["robots"]["r"]["pose"] == [0.25 * n, 0.0, 0.0]
            check(mapper, client)


def test_a_change_is_told_without_waiting_for_a_heartbeat(mapper, monkeypatch):
    monkeypatch.setattr("ogm_services.mapper.serving.live_client.HEARTBEAT", 3600.0)
    with client_of(mapper) as client:
        client.view(rate=20)
        for n in range(3):
            mapper.scan([1.0], pose=[0.0, 0.0, 0.0], at=n)
            client.until(lambda message, n=n: message["revision"] == 1 + n)
        client.view(AROUND, z=15)
        assert len(client.next()["tiles"]) > 0


def test_a_pose_alone_is_told_and_costs_no_tile(mapper):
    mapper.draw_cross()
    with client_of(mapper) as client:
        client.view(rate=20)
        client.next()
        mapper.pose(1.5, 2.5, 0.5, robot="other", at=100)
        update = client.until(lambda message: "other" in message["robots"])
        assert update["robots"]["other"]["pose"] == [1.5, 2.5, 0.5]
        assert update["tiles"] == []


def test_after_a_reset_all_is_forgotten(mapper):
    mapper.draw_cross()
    with client_of(mapper) as client:
        client.view(rate=20)
        before = client.next()
        mapper.http.post("/reset").raise_for_status()
        update = client.until(lambda message: message["epoch"] != before["epoch"])
        assert (update["run"], update["revision"], update["tiles"]) == (before["run"], 0, [])
        client.tiles = {}
        mapper.scan([1.0], pose=[0.0, 0.0, 0.0], at=100)
        client.until(lambda message: message["revision"] == 1)
        check(mapper, client)


def test_a_restarted_mapper_is_another_run_of_the_same_map(start_mapper, tmp_path):
    with start_mapper(map={"resolution": 0.5}, mapper={"data": tmp_path}) as mapper:
        mapper.draw_cross()
        with client_of(mapper) as client:
            client.view()
            client.next()
            before, tiles = client.hello, client.tiles
    with (
        start_mapper(map={"resolution": 0.5}, mapper={"data": tmp_path}) as mapper,
        client_of(mapper) as client,
    ):
        assert (client.hello["epoch"], client.hello["revision"]) == (before["epoch"], 3)
        assert client.hello["run"] != before["run"]
        client.view()
        client.next()
        assert {tile: png for tile, (_, png) in client.tiles.items()} == {
            tile: png for tile, (_, png) in tiles.items()
        }


def test_who_comes_back_gets_what_it_has_missed(mapper):
    mapper.draw_cross()
    with client_of(mapper) as client:
        client.view()
        known = client.next()["revision"]
    mapper.scan([1.0], pose=[10.0, 10.0, 0.0], at=100)
    mapper.settle(received=4)
    with client_of(mapper) as client:
        client.view(since=known)
        assert [tile[:4] for tile in client.next()["tiles"]] == [[16, 0, -1, 4]]


def test_what_comes_into_view_is_pushed_once_it_changes(mapper):
    mapper.draw_cross()
    with client_of(mapper) as client:
        client.view([0, 0, 0, 0], rate=20)
        assert len(client.next()["tiles"]) == 1
        client.view(AROUND, rate=20)
        mapper.scan([1.0], pose=[10.0, 10.0, 0.0], at=100)
        client.until(lambda message: message["revision"] == 4)
        assert client.tiles[16, 0, -1] == fetched(mapper, (16, 0, -1))


class TestBadClients:
    def test_a_hundred_that_send_garbage_are_cut_off_with_a_reason(self, sound, eventually):
        for n in range(100):
            with client_of(sound) as client:
                client.socket.send(os.urandom(1 + n * 7))
                code, reason = client.closed()
                assert code == 1008
                assert 0 < len(reason.encode()) <= 123
        eventually(lambda: live(sound) == 0)
        assert ended(sound, "malformed") == 100

    @pytest.mark.parametrize(
        ("said", "reason"),
        [
            ("hello", "a text frame: "),
            (msgpack.packb({"type": "view", "z": 16}), "tiles: "),
            (msgpack.packb({"type": "view", "z": 16, "tiles": [0, 0, 99, 99]}), "tiles: 256 at most"),
            (msgpack.packb({"type": "view", "z": 16, "tiles": [0, 0, 10**6, 0]}), "tiles: 256 at most"),
            (msgpack.packb({"type": "view", "z": 16, "tiles": [0, 0, 10**9, 0]}), "tiles.2: "),
            (msgpack.packb({"type": "view", "z": 16, "tiles": AROUND, "palette": "é" * 200}), "palette: "),
        ],
    )
    def test_so_is_what_is_no_view_after_one_that_is(self, cross, said, reason):
        with client_of(cross) as client:
            client.view()
            client.next()
            client.socket.send(said)
            code, told = client.closed()
            assert (code, told[: len(reason)]) == (1008, reason)

    def test_what_is_too_long_is_not_read(self, cross):
        with client_of(cross) as client:
            client.socket.send(bytes(65537))
            assert client.closed()[0] == 1009

    def test_a_flood_of_views_is_answered_by_the_newest(self, cross):
        with client_of(cross) as client:
            for n in range(1000):  # more at once are refused: a slow machine may read all of them at once
                client.view([n, 0, n, 0], rate=20)
            client.view(since=0)
            client.until(lambda message: len(message["tiles"]) == 3)
            check(cross, client)

    def test_one_that_never_reads_keeps_no_other_waiting(self, start_mapper, eventually, no_errors):
        """What it has missed it gets at once when it reads again, and it is then where all are."""
        rng = np.random.default_rng(5)
        with start_mapper(map={"resolution": 0.05}) as mapper, ExitStack() as stack:
            stuck, well = (stack.enter_context(client_of(mapper, buffer=4096)) for _ in range(2))
            for client in (stuck, well):
                client.view([-2, -2, 1, 1], rate=20)
            for n in range(200):
                ranges = rng.uniform(1.0, 8.0, 360)
                mapper.scan(ranges, pose=[*rng.uniform(-9.0, 9.0, 2), 0.0], angle_increment=0.0174, at=n)
            well.until(lambda message: message["revision"] == 200 and not message["more"])
            check(mapper, well)
            messages = 1
            while stuck.next()["revision"] < 200:
                messages += 1
            assert messages < 60  # those that were on the way, and one
            eventually(lambda: stuck.next()["tiles"] == [])
            check(mapper, stuck)


class TestWhoIsLetIn:
    def test_pages_of_other_origins_are_not(self, cross, caplog):
        host = cross.http.base_url.netloc.decode()
        before = ended(cross, "origin")
        for origin in ("http://evil.example", f"http://{host}.evil.example", "null", "http://localhost:1"):
            assert refusal(cross, {"Origin": origin}) == (403, "cross-origin")
        assert ended(cross, "origin") == before + 4
        assert any("/ws refused over HTTP" in record.getMessage() for record in caplog.records)
        for scheme in ("http", "https"):
            with client_of(cross, {"Origin": f"{scheme}://{host}"}) as client:
                assert client.hello["type"] == "hello"

    def test_under_a_foreign_name_nobody_is(self, cross, caplog):
        assert refusal(cross, host="evil.example") == (421, "misdirected")
        assert any("evil.example" in record.getMessage() for record in caplog.records)

    def test_elsewhere_nobody_is(self, cross):
        for path in ("/nowhere/ws", "//ws", "/%2fws", "/%ff/ws"):
            assert refusal(cross, path=path) == (404, "not-found")

    def test_no_token_is_needed_to_look(self, start_mapper, no_errors):
        with start_mapper(http={"token": "0123456789abcdef"}) as mapper:
            assert mapper.http.post("/reset").status_code == 401
            with client_of(mapper) as client:
                client.view()
                assert client.next()["type"] == "update"

    def test_64_are_and_the_next_one_once_one_of_them_has_left(self, start_mapper, eventually, no_errors):
        with start_mapper() as mapper, ExitStack() as stack:
            clients = [stack.enter_context(client_of(mapper)) for _ in range(64)]
            assert live(mapper) == 64
            assert refusal(mapper) == (503, "busy")
            for client in clients:
                client.view()
                assert client.next()["type"] == "update"
            clients[0].socket.close()
            eventually(lambda: live(mapper) == 63)
            assert (ended(mapper, "left"), ended(mapper, "full")) == (1, 1)
            stack.enter_context(client_of(mapper))

    def test_below_the_path_that_the_mapper_is_served_under_they_are(self, start_mapper):
        """Whether a reverse proxy strips it or not."""
        with start_mapper(http={"root_path": "/maps/hall"}) as mapper:
            for path in ("/maps/hall/ws", "/ws"):
                with client_of(mapper, path=path) as client:
                    assert client.hello["map"] == "hall"
            with pytest.raises(InvalidStatus), client_of(mapper, path="/maps/ws"):
                pass

    def test_who_finds_no_turn_is_told_to_come_later(self, mapper, monkeypatch, no_errors):
        def busy(_):
            raise Busy("live: no turn came within 5 s: try again later")

        monkeypatch.setattr("ogm_services.mapper.serving.live_updates.LiveUpdates.hello", busy)
        with pytest.raises(ConnectionClosed) as end, client_of(mapper):
            pass
        assert (end.value.rcvd.code, end.value.rcvd.reason[:5]) == (1013, "live:")
        assert ended(mapper, "full") == 1

    def test_how_many_is_a_setting(self, start_mapper):
        with start_mapper(http={"max_live": 1}) as mapper, client_of(mapper):
            assert refusal(mapper) == (503, "busy")

    def test_who_asks_without_a_handshake_is_told_so(self, cross):
        for method in ("GET", "HEAD"):
            answer = cross.http.request(method, "/ws")
            assert (answer.status_code, answer.headers["upgrade"]) == (426, "websocket")
        assert cross.http.get("/ws").json()["type"] == "upgrade-required"


def test_when_the_mapper_stops_its_clients_are_told(start_mapper, no_errors):
    with ExitStack() as stack:
        with start_mapper() as mapper:
            clients = [stack.enter_context(client_of(mapper)) for _ in range(3)]
            clients[0].view()
            clients[0].next()
        for client in clients:
            assert client.closed() == (1001, "the mapper stops")


def test_while_nobody_looks_nothing_is_copied(mapper, monkeypatch, eventually):
    copied = []
    snapshot = type(mapper.service.live_map).snapshot
    monkeypatch.setattr(
        type(mapper.service.live_map), "snapshot", lambda self: (copied.append(1), snapshot(self))[1]
    )
    with client_of(mapper) as client:
        client.view()
        client.next()
    eventually(lambda: live(mapper) == 0)
    mapper.status()
    copied.clear()
    for n in range(5):
        mapper.pose(n, robot="other", at=n)
        mapper.scan([1.0], pose=[0.0, 0.0, 0.0], at=n)
    eventually(lambda: mapper.service.live_map.now.revision == 5)
    assert copied == []


def test_a_bug_is_logged_and_said_to_be_one(mapper, caplog, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr("ogm_services.mapper.serving.live_updates.LiveUpdates.update", broken)
    with client_of(mapper) as client:
        client.view()
        assert client.closed() == (1011, "the mapper failed; see its log")
    assert ended(mapper, "failed") == 1
    (record,) = [record for record in caplog.records if record.exc_info]
    assert record.exc_info[0] is ZeroDivisionError
    caplog.clear()
