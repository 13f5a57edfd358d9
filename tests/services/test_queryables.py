"""Queries of a service that is busy: so many wait, the others are refused, and each gets a reply."""

import json
import threading
from contextlib import ExitStack

import pytest
import zenoh

from ogm_client.session import NetworkConfig, open_session
from ogm_services.replies import queryables as queryables_module
from ogm_services.replies import turns as turns_module
from ogm_services.replies.answer import Answer
from ogm_services.replies.queryables import Queryables
from ogm_services.replies.turns import MAX_QUESTIONS, Turns

KEY = "ogm/v1/hall/slow"
DEADLINE = 20.0


class SlowService:
    """Answers every query with its number, once it may; two threads."""

    def __init__(self, session):
        self.go_on = threading.Event()
        self.begun = 0
        self.turns, self.queryables = Turns("test", threads=2), Queryables(session)
        self.queryables.declare(KEY, self._answer, self.turns)

    def _answer(self, given):
        self.begun += 1
        assert self.go_on.wait(DEADLINE)
        return Answer(given["n"].encode(), "text/plain")


@pytest.fixture
def service(listener):
    service = SlowService(listener)
    yield service
    service.go_on.set()
    service.queryables.close()
    service.turns.close()


@pytest.fixture
def ask(endpoint):
    """`ask(n)` sends a query; the replies to all of them are gathered in the order in which they come."""
    replies = []
    with open_session(NetworkConfig(connect=(endpoint,))) as session:

        def send(number):
            handler = zenoh.handlers.Callback(replies.append, indirect=False)
            session.get(f"{KEY}?n={number}", handler, timeout=DEADLINE)
            return replies

        yield send


def test_past_so_many_that_wait_queries_are_refused_at_once_and_all_others_answered(service, ask, eventually):
    room = 2 + MAX_QUESTIONS
    assert MAX_QUESTIONS == 64
    for number in range(room):
        ask(number)
    for number in range(3):
        replies = ask(room + number)
    eventually(lambda: len(replies) == 3, DEADLINE)  # while not one of the others has an answer
    for reply in replies:
        assert str(reply.err.encoding) == "application/problem+json"
        problem = json.loads(reply.err.payload.to_bytes())
        assert (problem["type"], problem["status"], problem["title"]) == ("busy", 503, "Service Unavailable")
        assert problem["detail"] == "64 others wait for test already: try again later"
    assert service.begun == 2
    service.go_on.set()
    eventually(lambda: len(replies) == room + 3, DEADLINE)
    answers = sorted(int(reply.ok.payload.to_string()) for reply in replies[3:])
    assert answers == list(range(room))
    ask("again")
    eventually(lambda: len(replies) == room + 4, DEADLINE)
    assert replies[-1].ok.payload.to_string() == "again"


def test_a_query_of_a_service_that_stops_is_told(service, ask, eventually):
    service.turns.close()
    replies = ask(0)
    eventually(lambda: len(replies) == 1, DEADLINE)
    problem = json.loads(replies[0].err.payload.to_bytes())
    assert (problem["type"], problem["detail"]) == ("unavailable", "the service is stopping")


def test_who_waits_too_long_is_told_while_all_threads_are_busy(service, ask, eventually, monkeypatch):
    monkeypatch.setattr(turns_module, "TURN_PATIENCE", 0.3)
    for number in range(2):
        ask(number)
    eventually(lambda: service.begun == 2, DEADLINE)
    for number in range(2, 5):
        replies = ask(number)
    eventually(lambda: len(replies) == 3, DEADLINE)
    for reply in replies:
        problem = json.loads(reply.err.payload.to_bytes())
        assert (problem["type"], problem["status"]) == ("busy", 503)
    service.go_on.set()
    eventually(lambda: len(replies) == 5, DEADLINE)
    assert service.begun == 2


class StuckLink:
    """A session whose queries come from a reader that takes nothing until `moves`."""

    def __init__(self):
        self.moves, self.sending, self.ended = threading.Event(), [], 0

    def declare_queryable(self, _key, handler, complete):
        self.ask = lambda parameters="": handler.callback(StuckQuery(self, parameters))
        return ExitStack()


class StuckQuery:
    key_expr, payload, attachment = KEY, None, None

    def __init__(self, link, parameters):
        self.parameters, self._link = parameters, link

    def reply(self, *_, **__):
        self._send("ok")

    def reply_err(self, body, **_):
        self._send(json.loads(body)["type"])

    def _send(self, what):
        self._link.sending.append(what)
        assert self._link.moves.wait(DEADLINE)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._link.ended += 1


@pytest.fixture
def stuck():
    """`stuck(body, threads)`: a StuckLink, whose queries get `body`."""
    with ExitStack() as opened:

        def declare(body, threads):
            link, turns = StuckLink(), Turns("test", threads=threads)
            queryables = Queryables(link)
            for end in (turns.close, queryables.close, link.moves.set):
                opened.callback(end)
            queryables.declare(KEY, lambda _: Answer(body, "text/plain"), turns)
            return link

        yield declare


def test_refusals_hold_up_neither_who_calls_nor_who_sees_to_the_late(stuck, eventually, monkeypatch):
    monkeypatch.setattr(turns_module, "TURN_PATIENCE", 0.2)
    link = stuck(b"small", threads=1)
    link.ask("a" * 5000)  # it would not return
    for _ in range(1 + MAX_QUESTIONS + 10):
        link.ask()
    eventually(lambda: sorted(link.sending) == ["bad-parameter", "ok"], DEADLINE)
    (clock,) = (t for t in threading.enumerate() if t.name == "ogm-test-clock")
    link.moves.set()
    eventually(lambda: link.ended == 1 + MAX_QUESTIONS + 11, DEADLINE)
    assert link.sending.count("busy") >= 10
    assert link.sending.count("bad-parameter") == 1
    assert clock.is_alive()


def test_past_so_many_errors_that_wait_queries_end_without_one(stuck, eventually, caplog):
    link = stuck(b"small", threads=1)
    for _ in range(2):
        link.ask("long" * 2000)
    eventually(lambda: link.sending == ["bad-parameter"], DEADLINE)
    for _ in range(3):
        link.ask("long" * 2000)
    assert (link.ended, caplog.records) == (0, [])
    for _ in range(5):
        link.ask("long" * 2000)
    assert link.ended == 5
    assert [record.getMessage() for record in caplog.records] == [
        "error replies: 4 wait to be sent: a query gets none"
    ]
    link.moves.set()
    eventually(lambda: link.ended == 10, DEADLINE)
    assert link.sending == ["bad-parameter"] * 5


def test_at_most_four_large_answers_are_sent_at_once(stuck, eventually, monkeypatch):
    monkeypatch.setattr(queryables_module, "LARGE_PATIENCE", 0.2)
    link = stuck(bytes(100_000), threads=8)
    for _ in range(8):
        link.ask()
    eventually(lambda: sorted(link.sending) == ["busy", *["ok"] * 4], DEADLINE)
    link.moves.set()
    eventually(lambda: link.ended == 8, DEADLINE)
    assert sorted(link.sending) == [*["busy"] * 4, *["ok"] * 4]
    link.ask()
    eventually(lambda: link.ended == 9, DEADLINE)
    assert link.sending[-1] == "ok"
