"""Maps that are ready to be sent: as many as there is room for."""

import pytest
from fastapi import Request

from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.serving.answer_cache import BYTES_BESIDES
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
    cache_room = 64 * 1024**2

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
    ready._answers.cache_room = room
    queries = [b"%d" % k + b"x" * query for k in range(7)]
    assert keep(ready, bytes(body), queries) == [1, 2, 3, 1, 2, 3, 1]
    ready._answers.cache_room = room // 4
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
