"""Maps that are ready to be sent: as many as there is room for."""

import pytest
from fastapi import Request

from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.serving.answer_cache import BYTES_BESIDES
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.content_coding import Accepted
from ogm_services.mapper.serving.ready_maps import Ready, ReadyMaps
from ogm_services.replies.answer import Answer

META = {
    "epoch": "e",
    "run": "r",
    "revision": 3,
    "stamp": 7,
    "resolution": 0.1,
    "origin": {"x": 0.0, "y": 0.0},
}


class Map:
    """Stands for the answers: a map that says how far it has come."""

    identity = Identity("e", "r", 3, 7)
    at_once = True

    def __init__(self):
        self.memory = AnswerMemory()

    def now(self):
        return self.identity


def request(query):
    return Request({"type": "http", "path": "/map.png", "query_string": query, "headers": []})


@pytest.fixture
def ready():
    return ReadyMaps(Map())


def keep(ready, body, queries):
    """How many are kept after each query."""
    counts = []
    for query in queries:
        response = ready.keep(request(query), Ready.map(Answer(body, "image/png", META)))
        assert response.body == body
        counts.append(len(ready._ready))
    return counts


@pytest.mark.parametrize(("body", "query"), [(1_000_000, 10), (10, 1_000_000), (500_000, 500_000), (0, 0)])
def test_bodies_and_queries_of_any_length_have_the_same_room(ready, body, query):
    room = 3 * (body + query + len("/map.png") + 1 + BYTES_BESIDES)
    ready._answers.memory.cache_room = room
    queries = [b"%d" % k + b"x" * query for k in range(7)]
    assert keep(ready, bytes(body), queries) == [1, 2, 3, 1, 2, 3, 1]
    ready._answers.memory.cache_room = room // 4
    assert keep(ready, bytes(body), queries[:2]) == [0, 0]


def test_what_is_no_longer_the_map_is_not_kept(ready):
    assert keep(ready, b"old", [b"a", b"b"]) == [1, 2]
    ready._answers.identity = Identity("e", "r", 4, 8)
    assert keep(ready, b"old", [b"c"]) == [2]  # of revision 3, which nobody is sent any more
    for other in (Identity("f", "r", 3, 7), Identity("e", "s", 3, 7)):
        ready._answers.identity = other
        assert keep(ready, b"old", [b"c"]) == [2]


def test_what_is_kept_can_be_let_go(ready):
    assert keep(ready, b"body", [b"a", b"b"]) == [1, 2]
    ready.let_go()
    assert (ready.nbytes, ready._ready) == (0, {})
    assert keep(ready, b"body", [b"a"]) == [1]


def test_a_text_that_is_packed_takes_the_place_of_the_one_that_is_not(ready):
    text = Answer(b"[" + b"0," * 2000 + b"0]", "application/json", META)
    plain, packing = request(b""), request(b"")
    packing.scope["headers"] = [(b"accept-encoding", b"gzip")]
    ready.keep(plain, Ready.map(text))
    before = ready.nbytes
    packed = Ready.map(text, Accepted(gzip=True, identity=True))
    for _ in range(2):
        response = ready.keep(packing, packed)
        assert ready.nbytes == before + len(response.body) < before + len(text.body) // 10
    assert [len(one.body) for one in (ready.keep(plain, packed), response)] == [
        len(text.body),
        ready.nbytes - before,
    ]


@pytest.mark.parametrize("accepted", [b"gzip", b"gzip;q=0.5", b"*"])
def test_who_takes_gzip_has_what_is_not_packed_made_anew(ready, accepted):
    made = Ready.map(Answer(bytes(2000), "text/plain", META))
    scope = {"headers": [(b"accept-encoding", accepted)]}
    assert made.response_to(scope) is None
    assert made.response_to({"headers": []}).body == bytes(2000)
    scope["headers"].append((b"if-none-match", b'"e-r-3"'))
    assert made.response_to(scope).status_code == 304


def test_under_a_path_a_map_is_kept_by_the_path_that_is_left_as_it_is_looked_for(ready):
    under = request(b"")
    under.scope |= {"path": "/maps/hall/map.png", "root_path": "/maps/hall"}
    ready.keep(under, Ready.map(Answer(b"body", "image/png", META)))
    assert list(ready._ready) == [("/map.png", b"")]
