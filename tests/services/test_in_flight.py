"""Answers in flight: what slow readers hold is counted until it is gone, and bounded together."""

import socket
import threading
import tracemalloc
from contextlib import ExitStack

import httpx
import pytest
import uvicorn
from starlette.applications import Starlette
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from ogm_services.mapper.serving.in_pieces import PIECE, InPieces
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import BUFFERED, MAX_IN_FLIGHT, SMALL, InFlight

MIB = 1024**2
LIMIT = 40 * MIB
DEADLINE = 30.0
AS_IT_IS = {"Accept-Encoding": "identity"}
"""Packed, an answer that is kept takes little while it is sent."""


def test_the_limit():
    assert MAX_IN_FLIGHT == InFlight().limit == 256 * MIB


def test_bodies_count_until_they_are_sent_and_past_the_limit_none_is():
    in_flight = InFlight(12 * MIB)
    with in_flight.sending(bytes(4 * MIB)), in_flight.sending(bytes(4 * MIB)):
        assert in_flight.held == 8 * MIB + 2 * BUFFERED
        with pytest.raises(Busy, match=r"answers of 10 MiB are being made or sent, and this one has 3 MiB"):
            in_flight.sending(bytes(3 * MIB)).__enter__()
        with in_flight.sending(bytes(1 * MIB)):
            pass
    assert in_flight.held == 0


def test_a_body_that_is_sent_to_many_counts_once():
    in_flight, body = InFlight(14 * MIB), bytes(6 * MIB)
    with ExitStack() as readers:
        for k in range(8):
            readers.enter_context(in_flight.sending(body))
            assert in_flight.held == 6 * MIB + (k + 1) * BUFFERED
    assert in_flight.held == 0
    with in_flight.sending(body):
        assert in_flight.held == 6 * MIB + BUFFERED


def test_what_is_being_made_counts_too():
    in_flight = InFlight(10 * MIB)
    with in_flight.making(6 * MIB):
        assert in_flight.held == 6 * MIB
        with pytest.raises(
            Busy, match="answers of 6 MiB are being made or sent, and making this one takes 5 MiB"
        ):
            in_flight.making(5 * MIB).__enter__()
        with in_flight.sending(bytes(3 * MIB)), in_flight.making(SMALL):
            assert in_flight.held == 9 * MIB + BUFFERED
    assert in_flight.held == 0
    with pytest.raises(ZeroDivisionError), in_flight.making(MIB):
        raise ZeroDivisionError
    assert in_flight.held == 0


def test_one_alone_may_be_larger_than_all_together():
    in_flight = InFlight(MIB)
    with in_flight.sending(bytes(3 * MIB)), pytest.raises(Busy):
        in_flight.sending(bytes(SMALL + 1)).__enter__()
    with in_flight.sending(bytes(2 * MIB)):
        pass


def test_none_may_be_larger_than_the_memory_that_is_left():
    in_flight = InFlight(left=lambda: 2 * MIB)
    with pytest.raises(Busy):
        in_flight.sending(bytes(2 * MIB)).__enter__()
    with in_flight.sending(bytes(MIB)):
        pass


def test_small_bodies_are_always_sent_and_not_counted():
    in_flight = InFlight(MIB)
    with in_flight.sending(bytes(MIB)), in_flight.sending(bytes(SMALL)):
        assert in_flight.held == MIB + BUFFERED


def test_a_short_body_is_on_its_way_once_more_at_most():
    in_flight = InFlight()
    with in_flight.sending(bytes(2 * SMALL)), in_flight.sending(bytes(3 * SMALL)):
        assert in_flight.held == 10 * SMALL
    assert in_flight.held == 0


def test_what_ends_by_an_error_is_gone_too():
    in_flight = InFlight()
    with pytest.raises(ZeroDivisionError), in_flight.sending(bytes(MIB)):
        raise ZeroDivisionError
    assert in_flight.held == 0


class Server:
    """uvicorn before an application of long bodies: /fresh is made for each, /kept is one for all."""

    def __init__(self, parser):
        self.in_flight = InFlight(LIMIT)
        kept = bytes(range(256)) * (8 * MIB // 256)
        app = Starlette(
            routes=[
                Route("/fresh", lambda _: Response(bytes(8 * MIB))),
                Route("/kept", lambda _: Response(kept)),
                Route("/small", lambda _: Response(b"small")),
                Route("/stream", lambda _: StreamingResponse(iter([kept[:MIB], kept[MIB:], b"end"]))),
            ]
        )
        self.kept = kept
        app.add_middleware(InPieces, in_flight=self.in_flight)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        config = uvicorn.Config(app, http=parser, log_config=None, timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([self._listener],))

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._server.should_exit = True
        self._thread.join(DEADLINE)
        self._listener.close()

    def get(self, path):
        return httpx.get(f"http://127.0.0.1:{self.port}{path}", timeout=DEADLINE)

    def stalled(self, path):
        """A client that asks and does not read."""
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect(("127.0.0.1", self.port))
        client.sendall(f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
        return client


@pytest.fixture(params=["httptools", "h11"])
def server(request):
    with Server(request.param) as server:
        yield server


def test_long_bodies_arrive_whole(server):
    assert server.get("/kept").content == server.kept
    assert server.get("/fresh").content == bytes(8 * MIB)
    assert server.get("/small").content == b"small"
    assert server.get("/stream").content == server.kept + b"end"
    assert httpx.head(f"http://127.0.0.1:{server.port}/kept").headers["content-length"] == str(8 * MIB)
    assert server.in_flight.held == 0


def test_slow_readers_hold_what_they_do_not_read_and_the_next_is_told_to_come_later(server, eventually):
    with ExitStack() as clients:
        for k in range(1, 5):
            clients.enter_context(server.stalled("/fresh"))
            eventually(lambda k=k: server.in_flight.held == k * (8 * MIB + BUFFERED))
        response = server.get("/fresh")
        assert (response.status_code, response.headers["retry-after"]) == (503, "2")
        assert response.headers["content-type"] == "application/problem+json"
        assert response.headers["cache-control"] == "no-store"
        assert response.json()["type"] == "busy"
        assert server.get("/small").content == b"small"
        assert server.in_flight.held == 4 * (8 * MIB + BUFFERED)
    eventually(lambda: server.in_flight.held == 0)
    assert server.get("/fresh").status_code == 200


def test_many_slow_readers_of_one_body_hold_it_once(server, eventually):
    tracemalloc.start()
    try:
        with ExitStack() as clients:
            for _ in range(30):
                clients.enter_context(server.stalled("/kept"))
            eventually(lambda: server.in_flight.held == 8 * MIB + 30 * BUFFERED)
            held, _ = tracemalloc.get_traced_memory()
            assert held < 8 * MIB + 30 * (BUFFERED + PIECE)  # 30 copies are five times that
        eventually(lambda: server.in_flight.held == 0)
    finally:
        tracemalloc.stop()


def test_a_mapper_counts_over_http_and_zenoh_together(start_mapper, eventually):
    with start_mapper(map={"resolution": 0.1}) as mapper:
        mapper.scan([30.0] * 60, pose=[0.0, 0.0, 0.0], range_max=40.0)
        mapper.settle(received=1)
        body = mapper.http.get("/map.json", headers=AS_IT_IS).content
        assert len(body) > SMALL
        held = mapper.service.parts.in_flight
        assert held.limit == MAX_IN_FLIGHT
        eventually(lambda: held.held == 0)  # who has read an answer is there before it is let go
        assert mapper.service.memory.held()["caches"] >= 2 * len(body)
        assert mapper.service.memory.limits()["answers"] == MAX_IN_FLIGHT
        held.limit = MIB
        with held.sending(bytes(MIB)):
            assert mapper.service.memory.held()["answers"] == held.held > MIB
            assert mapper.http.get("/map.json", headers=AS_IT_IS).status_code == 503
            assert mapper.problem("map")["type"] == "busy"
            assert mapper.http.get("/status").status_code == 200
            assert mapper.answer("status")
        assert (
            mapper.http.get("/map.json", headers=AS_IT_IS).content
            == mapper.answer("map").payload.to_bytes()
            == body
        )
        eventually(lambda: held.held == 0)


def test_no_answer_is_larger_than_what_max_memory_leaves(start_mapper, eventually):
    with start_mapper(map={"resolution": 0.1}) as mapper:
        mapper.scan([30.0] * 60, pose=[0.0, 0.0, 0.0], range_max=40.0)
        mapper.settle(received=1)
        assert mapper.http.get("/map.json", headers=AS_IT_IS).status_code == 200
        memory, held = mapper.service.memory, mapper.service.parts.in_flight
        eventually(lambda: held.held == 0)  # else there would be room for that answer
        memory.limit = memory.total() - memory.held()["caches"] + SMALL  # what is kept is in no answer's way
        assert mapper.http.get("/map.json", headers=AS_IT_IS).status_code == 503
        assert mapper.http.get("/status").status_code == 200


def test_what_will_not_fit_later_either_is_not_told_to_come_again():
    in_flight = InFlight(10 * MIB, left=lambda: 4 * MIB)
    why = "^making this one takes 5 MiB, for which mapper.max_memory has no room: ask for a smaller region"
    with pytest.raises(Busy, match=why):
        in_flight.making(5 * MIB).__enter__()
    with in_flight.making(3 * MIB), pytest.raises(Busy, match=r"answers of 3 MiB are .* try again later"):
        in_flight.making(5 * MIB).__enter__()
