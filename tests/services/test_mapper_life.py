"""A mapper's life: ready only when warm, reset, and what it says while it fails or stops."""

import asyncio
import json
import socket
import threading
import time
from contextlib import closing

import httpx
import pytest

from ogm_client.session import NetworkConfig, open_session
from ogm_core.cells.thresholds import FREE_BELOW
from ogm_core.errors import BadParameter
from ogm_services.mapper.intake.queue import ScanQueue
from ogm_services.mapper.live import first_warm_up, load
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.answering_threads import AnsweringThreads
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.http_routes import build_app
from ogm_services.mapper.serving.http_server import CannotServe, HttpThread
from ogm_services.mapper.serving.map_formats import MAP_FORMATS
from ogm_services.mapper.serving.metrics import Metrics
from ogm_services.replies.answer import Unavailable


class BrokenAnswers:
    """Answers with a bug in each; what routes are made of is there."""

    free_below = FREE_BELOW

    def __init__(self):
        self.memory = AnswerMemory()

    def map_parameters(self, form):
        """As every mapper's."""
        return Answers.map_parameters(self, form)

    def __getattr__(self, name):
        def answer(*_):
            raise ZeroDivisionError(f"a bug in {name}")

        return answer


def refuse(*_, **__):
    raise Unavailable("busy")


def ask(method, path, *, alive=True, ready=True, reset=refuse):
    """Ask an application of broken answers, without a server."""
    health = Health(lambda: alive, [lambda: None, lambda: None if ready else "it is not ready"])
    threads = AnsweringThreads(waiting=4)
    writes = dict.fromkeys(("reset", "erase", "forget", "save", "restore", "delete"), reset)
    app = build_app(
        BrokenAnswers(), health, writes, Metrics(), access=HttpAccess(hosts=("mapper",)), threads=threads
    )

    async def send():
        transport = httpx.ASGITransport(app, raise_app_exceptions=False)
        async with httpx.AsyncClient(transport=transport, base_url="http://mapper") as client:
            return await client.request(method, path)

    with closing(threads):
        return asyncio.run(send())


def problem(response):
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    body = response.json()
    assert (body["status"], body["title"]) == (response.status_code, response.reason_phrase)
    return response.status_code, body["type"]


@pytest.mark.parametrize(
    ("alive", "ready", "livez", "readyz"),
    [(True, True, 200, 200), (True, False, 200, 503), (False, True, 503, 503), (False, False, 503, 503)],
)
def test_probes(alive, ready, livez, readyz):
    health = {"alive": alive, "ready": ready}
    assert ask("GET", "/livez", **health).status_code == livez
    assert ask("GET", "/readyz", **health).status_code == readyz
    assert ask("HEAD", "/readyz", **health).status_code == readyz
    assert ask("GET", "/readyz", **health).headers["cache-control"] == "no-store"


def test_a_probe_says_every_reason_why_not():
    assert Health(lambda: True).not_ready() is None
    health = Health(lambda: False, [lambda: "one", lambda: None, lambda: "two"])
    assert health.not_ready() == "the worker has stopped; one; two"
    assert ask("GET", "/readyz", ready=False).text == "it is not ready"
    assert ask("GET", "/readyz").text == "ok"


@pytest.mark.parametrize("path", ["/map.png", "/status", "/metrics"])
def test_a_bug_is_logged_and_told_without_its_innards(caplog, path):
    response = ask("GET", path)
    assert problem(response) == (500, "internal")
    assert "bug" not in response.text
    (record,) = caplog.records
    assert (record.levelname, record.exc_info[0]) == ("ERROR", ZeroDivisionError)


def test_a_reset_that_cannot_be_done_is_told():
    def refuse_parameter(*_, **__):
        raise BadParameter("no")

    assert problem(ask("POST", "/reset")) == (503, "unavailable")
    assert problem(ask("POST", "/reset", reset=refuse_parameter)) == (400, "bad-parameter")


@pytest.fixture
def while_starting(start_mapper, monkeypatch, endpoint):
    """`while_starting(look)` starts a mapper, and calls look(http, ask) when it has kernels to make ready."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    warm_up = first_warm_up.warm_up

    def start(look):
        def look_and_warm_up(settings, threads):
            url, network = f"http://127.0.0.1:{port}", NetworkConfig(connect=(endpoint,))
            with httpx.Client(base_url=url, timeout=30.0) as http, open_session(network) as session:
                look(http, lambda key: list(session.get(f"ogm/v1/hall/{key}", timeout=30.0)))
            warm_up(settings, threads)

        monkeypatch.setattr(first_warm_up, "warm_up", look_and_warm_up)
        return start_mapper(http={"port": port}, network={"listen": [endpoint]})

    return start


def test_while_it_starts_it_lives_and_tells_everybody_to_come_again(while_starting):
    seen, served = {}, {"/livez": 200, "/readyz": 503, "/version": 200, "/": 200}
    routes = [f"/map.{form}" for form in MAP_FORMATS] + ["/cell?x=0&y=0", "/quality", "/status", "/metrics"]

    def look(http, _):
        seen.update({path: http.get(path) for path in (*served, *routes)})
        seen["reset"] = http.post("/reset")

    with while_starting(look) as mapper:
        assert {path: seen.pop(path).status_code for path in served} == served
        assert len(seen) == len(routes) + 1
        for response in seen.values():
            assert problem(response) == (503, "starting")
            assert int(response.headers["retry-after"]) > 0
        assert mapper.http.get("/readyz").status_code == 200
        assert mapper.draw_cross()["revision"] == 3
        for path in routes:
            assert mapper.http.get(path).status_code == 200, path
            assert "retry-after" not in mapper.http.get(path).headers


def test_while_it_starts_every_queryable_says_so(while_starting, eventually):
    seen = {}
    keys = ("map", "cell", "quality", "status", "reset")

    def look(_, ask):
        # What it declares reaches another session a moment after that has opened.
        seen.update({key: eventually(lambda key=key: ask(key), 10.0) for key in keys})

    with while_starting(look) as mapper:
        for key in keys:
            (reply,) = seen[key]
            assert str(reply.err.encoding) == "application/problem+json"
            told = json.loads(reply.err.payload.to_bytes())
            assert (told["type"], told["status"]) == ("starting", 503)
        assert json.loads(mapper.answer("status").payload.to_bytes())["revision"] == 0


def test_a_taken_http_port_is_said_with_its_flag(cross, start_mapper):
    taken = cross.http.base_url.port
    with pytest.raises(CannotServe, match=f"--http-port {taken}"), start_mapper(http={"port": taken}):
        pass


def test_while_it_stops_it_is_not_ready_and_says_so(start_mapper, in_background, eventually):
    go_on = threading.Event()
    with start_mapper() as mapper:
        assert mapper.http.get("/readyz").text == "ok"
        in_background(mapper.service.parts.worker.do, lambda: go_on.wait(30.0))
        eventually(lambda: not mapper.service.parts.queue._items)
        ended = in_background(mapper.service.__exit__, None, None, None)
        try:
            answer = eventually(lambda: (a := mapper.http.get("/readyz")).status_code == 503 and a)
            assert answer.text == "the mapper is stopping"
            assert mapper.http.get("/livez").status_code == 200
        finally:
            go_on.set()
        ended.result(30.0)


def test_a_worker_that_was_stopped_is_no_reason_to_start_the_mapper_again(
    start_mapper, in_background, eventually, monkeypatch
):
    go_on, stop = threading.Event(), HttpThread.__exit__
    monkeypatch.setattr(HttpThread, "__exit__", lambda http, *why: (go_on.wait(30.0), stop(http, *why)))
    with start_mapper() as mapper:
        ended = in_background(mapper.service.__exit__, None, None, None)
        try:
            eventually(lambda: not mapper.service.working)
            assert mapper.http.get("/readyz").text == "the mapper is stopping"
            assert mapper.http.get("/livez").status_code == 200
        finally:
            go_on.set()
        ended.result(30.0)


def test_a_mapper_that_falls_behind_is_not_ready(start_mapper, monkeypatch, eventually):
    work = [0.0]
    monkeypatch.setattr(ScanQueue, "work", property(lambda _: work[0]))
    with start_mapper() as mapper:
        work[0] = 4.9
        monkeypatch.setattr(load, "HOLD", 0.0)
        eventually(lambda: mapper.http.get("/readyz").status_code == 503)
        assert mapper.http.get("/readyz").text == "the mapper falls behind: 4.9 s of work wait"
        work[0] = 0.1
        eventually(lambda: mapper.http.get("/readyz").status_code == 200)


def test_a_worker_that_has_ended_is_not_alive(mapper):
    assert mapper.http.get("/livez").text == "ok"
    mapper.service.parts.worker.stop()
    assert mapper.http.get("/livez").status_code == 503
    assert mapper.http.get("/readyz").status_code == 503
    assert problem(mapper.http.post("/reset")) == (503, "unavailable")
    assert mapper.problem("reset")["type"] == "unavailable"
    assert mapper.status()["revision"] == 0


def test_a_command_that_fails_is_told_to_its_caller_and_harms_nobody_else(mapper, caplog):
    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        mapper.service.parts.worker.do(fail)
    assert mapper.draw_cross()["revision"] == 3
    assert [record.getMessage() for record in caplog.records] == ["a command failed"]
    caplog.clear()


def test_a_reset_that_waits_does_not_hold_up_the_end(start_mapper, in_background, eventually):
    with start_mapper() as mapper:
        parts = mapper.service.parts
        in_background(parts.worker.do, lambda: eventually(lambda: parts.queue.closed))
        replies = [in_background(mapper.http.post, "/reset"), in_background(mapper.ask, "reset")]
        eventually(lambda: len(parts.queue._items) == 2)
        started = time.monotonic()
        mapper.service.__exit__(None, None, None)
        assert time.monotonic() - started < 20.0  # far less than the 30 s that a reset may wait for its turn
        assert replies[0].result(30.0).status_code == 503
        assert replies[1].result(30.0)[0].err is not None


def test_reset_begins_a_new_epoch_and_keeps_the_books(mapper):
    mapper.draw_cross()
    mapper.scan([1.0], pose=[0, 0, 0], run="a", seq=7)
    before = mapper.settle(received=4)
    assert problem(mapper.http.post("/reset?map=hall")) == (400, "bad-parameter")
    assert mapper.status()["epoch"] == before["epoch"]
    after = mapper.http.post("/reset").raise_for_status().json()
    assert after["epoch"] != before["epoch"]
    assert (after["revision"], after["stamp"]) == (0, None)
    assert (after["map_info"]["width"], after["map_info"]["bytes"]) == (0, 0)
    assert after["robots"]["r"].pop("age_s") > before["robots"]["r"].pop("age_s")
    for kept in ("scans", "poses", "other", "robots"):
        assert after[kept] == before[kept]
    assert problem(mapper.http.get("/map.png")) == (404, "map-empty")
    mapper.scan([1.0], pose=[0, 0, 0], run="a", seq=7)
    assert mapper.settle(received=5)["scans"]["dropped"]["duplicate"] == 1
    mapper.scan([1.0], pose=[0, 0, 0], run="a", seq=8, at=-9)
    again = mapper.settle(received=6)
    assert (again["revision"], again["stamp"]) == (1, 1_700_000_000_000_000_000 - 9)
    assert mapper.http.get("/map.json").headers["etag"] == f'"{after["epoch"]}-{before["run"]}-1"'


def test_poses_outlive_a_reset(mapper):
    mapper.pose(at=0)
    mapper.pose(at=100)
    mapper.http.post("/reset").raise_for_status()
    mapper.scan([1.0], at=50)
    assert mapper.settle(received=1)["scans"]["integrated"] == 1
