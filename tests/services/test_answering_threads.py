"""Answering threads: probes and the status are answered while maps and figures take all theirs."""

import json
import threading
from concurrent.futures import wait

import httpx
import pytest
import zenoh

from ogm_services.mapper.serving.answers import Answers
from ogm_services.replies import turns as turns_module
from ogm_services.replies.answer import Answer

CLIENTS = 40
DEADLINE = 30.0
PROBES = ["/status", "/livez", "/readyz", "/metrics", "/version"]


@pytest.fixture
def stuck(monkeypatch):
    """Figures and maps take until this is set."""
    go_on = threading.Event()

    def slow(*_):
        assert go_on.wait(DEADLINE)
        return Answer(b"{}", "application/json")

    monkeypatch.setattr(Answers, "quality", slow)
    monkeypatch.setattr(Answers, "cell", slow)
    monkeypatch.setattr(
        Answers, "map", lambda self, form, given, slow_map=Answers.map: slow() and slow_map(self, form, given)
    )
    yield go_on
    go_on.set()


def ask(mapper, path):
    return httpx.get(f"{str(mapper.http.base_url).rstrip('/')}{path}", timeout=DEADLINE)


def test_over_http_probes_are_answered_while_forty_ask_for_figures_and_maps(stuck, mapper, eventually):
    mapper.draw_cross()
    responses = []
    asking = [
        threading.Thread(target=lambda k=k: responses.append(ask(mapper, ("/quality", "/map.npz")[k % 2])))
        for k in range(CLIENTS)
    ]
    for thread in asking:
        thread.start()
    maps = mapper.service._http_threads.maps
    eventually(lambda: len(maps._waiting) == CLIENTS - 8)
    for path in PROBES:
        assert ask(mapper, path).status_code == 200
    assert not responses
    stuck.set()
    for thread in asking:
        thread.join(DEADLINE)
    assert [response.status_code for response in responses] == [200] * CLIENTS


def test_over_http_who_waits_too_long_gets_503_and_is_told_when_to_ask_again(
    stuck, mapper, eventually, monkeypatch, in_background
):
    monkeypatch.setattr(turns_module, "TURN_PATIENCE", 0.3)
    held = [in_background(ask, mapper, "/quality") for _ in range(8)]
    eventually(lambda: mapper.service._http_threads.maps._working == 8)
    late = [in_background(ask, mapper, path) for path in ("/map.png", "/cell?x=0&y=0", "/quality")]
    for response in (future.result(DEADLINE) for future in late):
        assert (response.status_code, response.headers["retry-after"]) == (503, "2")
        assert response.headers["content-type"] == "application/problem+json"
        assert response.json()["type"] == "busy"
        assert response.json()["detail"] == "maps: no turn came within 0.3 s: try again later"
    assert not any(future.done() for future in held)
    stuck.set()
    wait(held, DEADLINE)
    assert {future.result().status_code for future in held} == {200}


def test_over_zenoh_the_status_is_answered_while_others_take_every_other_thread(stuck, mapper, eventually):
    replies = []
    for _ in range(CLIENTS):
        handler = zenoh.handlers.Callback(replies.append, indirect=False)
        mapper.session.get(f"{mapper.keys.root}/quality", handler, timeout=DEADLINE)
    for _ in range(5):
        assert json.loads(mapper.answer("status").payload.to_bytes())["map"] == "hall"
    assert not replies
    stuck.set()
    eventually(lambda: len(replies) == CLIENTS)
    assert all(reply.ok is not None for reply in replies)


def test_writes_that_wait_for_the_worker_hold_up_neither(mapper, eventually, monkeypatch, in_background):
    go_on = threading.Event()
    monkeypatch.setattr(mapper.service.parts.worker, "do", lambda _: go_on.wait(DEADLINE))
    url = f"{mapper.http.base_url}reset"
    writing = [in_background(httpx.post, url, timeout=DEADLINE) for _ in range(10)]
    eventually(lambda: mapper.service._http_threads.writes._working == 2)
    for path in [*PROBES, "/quality", "/map.json"]:
        assert ask(mapper, path).status_code == 200
    go_on.set()
    assert {future.result(DEADLINE).status_code for future in writing} == {200}
