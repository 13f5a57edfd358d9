"""Pages of other origins: those that are named may read and, with the token, write; of all others nothing."""

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

TOKEN = "correct-horse-battery-staple"
NAMED, OTHER = "https://dash.example", "https://evil.example"
RIGHT = {"Authorization": f"Bearer {TOKEN}"}


def by_page(origin, **headers):
    """What a browser says of a page of another origin."""
    return {"Origin": origin, "Sec-Fetch-Site": "cross-site", **headers}


def asking(origin, method, *headers):
    """What a browser asks before it asks."""
    asked = {"Access-Control-Request-Method": method}
    if headers:
        asked["Access-Control-Request-Headers"] = ",".join(headers)
    return by_page(origin, **asked)


def shared(response):
    return {
        name.removeprefix("access-control-"): value
        for name, value in response.headers.items()
        if name.startswith("access-control-")
    }


def varies(response):
    return set(response.headers["vary"].split(", "))


@pytest.fixture(scope="module")
def sharing(start_mapper):
    http = {"cors_origins": [NAMED, "http://localhost:3000"], "token": TOKEN}
    with start_mapper(map={"resolution": 0.5}, http=http) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture(scope="module")
def open_to_all(start_mapper):
    with start_mapper(map={"resolution": 0.5}, http={"cors_origins": ["*"], "token": TOKEN}) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.mark.parametrize(
    "path", ["/map.json", "/status", "/tiles/16/0/-1.png", "/tiles.json", "/openapi.json"]
)
def test_a_page_that_is_named_reads_with_all_headers_of_a_map(sharing, path):
    for _ in range(2):  # the second time it is ready
        response = sharing.http.get(path, headers=by_page(NAMED)).raise_for_status()
        told = shared(response)
        assert told.pop("allow-origin") == NAMED
        named = told.pop("expose-headers").lower().split(", ")
        assert {name for name in response.headers if name.startswith("ogm-") or name == "etag"} <= set(named)
        assert told == {}  # no credentials
        assert varies(response) - {"Accept-Encoding"} == {"Origin"}
    assert shared(sharing.http.get(path, headers=by_page(NAMED.upper())))["allow-origin"] == NAMED.upper()


def test_what_is_known_and_what_is_refused_is_shared_too(sharing):
    etag = sharing.http.get("/map.json").headers["etag"]
    known = sharing.http.get("/map.json", headers=by_page(NAMED, **{"If-None-Match": etag}))
    assert (known.status_code, shared(known)["allow-origin"]) == (304, NAMED)
    for path, status in (("/map.json?no=1", 400), ("/nowhere", 404)):
        refused = sharing.http.get(path, headers=by_page(NAMED))
        assert (refused.status_code, shared(refused)["allow-origin"]) == (status, NAMED)


@pytest.mark.parametrize(
    "origin", [OTHER, "null", "", f"{NAMED}.evil.example", f"{NAMED}:8443", "http://dash.example"]
)
def test_no_other_page_is_told_anything(sharing, origin):
    for headers in (by_page(origin), asking(origin, "GET", "if-none-match"), asking(origin, "DELETE")):
        for method in ("GET", "OPTIONS"):
            response = sharing.http.request(method, "/map.json", headers=headers)
            assert shared(response) == {}
            assert "Origin" in varies(response)
    refused = sharing.http.post("/reset", headers=by_page(origin) | RIGHT)
    assert (refused.status_code, shared(refused)) == (403, {})


def test_who_sends_no_origin_is_told_that_answers_differ(sharing):
    response = sharing.http.get("/map.json")
    assert (shared(response), varies(response)) == ({}, {"Accept-Encoding", "Origin"})


def test_a_browser_is_told_what_a_page_that_is_named_may(sharing):
    response = sharing.http.options("/snapshots/a", headers=asking(NAMED, "DELETE", "authorization"))
    assert (response.status_code, response.content) == (204, b"")
    assert shared(response) == {
        "allow-origin": NAMED,
        "allow-methods": "DELETE, OPTIONS",
        "allow-headers": "Authorization, Content-Type, If-Match, If-None-Match",
        "max-age": "600",
        "expose-headers": shared(response)["expose-headers"],
    }
    unknown = sharing.http.options("/nowhere", headers=asking(NAMED, "GET"))
    assert (unknown.status_code, "allow-methods" in shared(unknown)) == (404, False)
    plain = sharing.http.options("/snapshots/a", headers=by_page(NAMED))
    assert (plain.headers["allow"], "allow-methods" in shared(plain)) == ("DELETE, OPTIONS", False)


def test_a_page_that_is_named_writes_with_the_token_and_by_no_cookie(sharing):
    epoch = sharing.status()["epoch"]
    cookie = sharing.http.post("/login", json={"token": TOKEN}).headers["set-cookie"].partition(";")[0]
    sharing.http.cookies.clear()
    for headers in ({}, {"Cookie": cookie}, {"Cookie": cookie, "Authorization": "Basic eDp5"}):
        assert sharing.http.post("/reset", headers=by_page(NAMED) | headers).status_code == 403
        own = {"Origin": NAMED, "Sec-Fetch-Site": "same-site"}
        assert sharing.http.post("/reset", headers=own | headers).status_code == 403
    wrong = by_page(NAMED, Authorization="Bearer x", Cookie=cookie)
    refused = sharing.http.post("/reset", headers=wrong)
    assert (refused.status_code, shared(refused)["allow-origin"]) == (401, NAMED)
    assert sharing.http.post("/login", json={"token": TOKEN}, headers=by_page(NAMED)).status_code == 403
    assert sharing.status()["epoch"] == epoch
    done = sharing.http.post("/reset", headers=by_page(NAMED) | RIGHT).raise_for_status()
    assert shared(done)["allow-origin"] == NAMED
    assert sharing.status()["epoch"] != epoch


def test_without_a_token_no_page_of_another_origin_writes(start_mapper):
    with start_mapper(http={"cors_origins": [NAMED, "*"]}) as mapper:
        for origin in (NAMED, OTHER):
            assert mapper.http.post("/reset", headers=by_page(origin) | RIGHT).status_code == 403
        assert mapper.http.post("/reset").status_code == 200


def test_where_all_may_read_none_writes_that_is_not_named(open_to_all):
    response = open_to_all.http.get("/map.json", headers=by_page(OTHER)).raise_for_status()
    assert shared(response)["allow-origin"] == "*"
    assert shared(open_to_all.http.get("/map.json"))["allow-origin"] == "*"
    assert varies(response) == {"Accept-Encoding"}
    told = shared(open_to_all.http.options("/map.json", headers=asking(OTHER, "GET", "if-none-match")))
    assert told["allow-methods"] == "GET, HEAD, OPTIONS"
    assert "Authorization" not in told["allow-headers"]
    told = shared(open_to_all.http.options("/reset", headers=asking(OTHER, "POST", "authorization")))
    assert told["allow-methods"] == "OPTIONS"
    assert open_to_all.http.post("/reset", headers=by_page(OTHER) | RIGHT).status_code == 403


def test_a_check_is_a_read(sharing, open_to_all):
    asked = {"points": [[0.25, 0.25]]}
    for mapper, origin, status in ((sharing, NAMED, 200), (sharing, OTHER, 403), (open_to_all, OTHER, 200)):
        told = shared(mapper.http.options("/check", headers=asking(origin, "POST", "content-type")))
        assert (told.get("allow-methods") == "OPTIONS, POST") is (status == 200)
        answer = mapper.http.post("/check", json=asked, headers=by_page(origin))
        assert answer.status_code == status


def test_a_host_that_is_not_the_mappers_is_not_shared_with_anybody(sharing):
    refused = sharing.http.get("/map.json", headers=by_page(NAMED) | {"Host": "evil.example"})
    assert (refused.status_code, shared(refused)) == (421, {})


def test_the_same_pages_may_watch_by_websocket(sharing, open_to_all):
    for mapper, origin in ((sharing, NAMED), (sharing, None), (open_to_all, OTHER)):
        with connect(live(mapper), origin=origin, proxy=None) as socket:
            assert socket.recv(timeout=30.0)
    with pytest.raises(InvalidStatus) as refused:
        connect(live(sharing), origin=OTHER, proxy=None)
    assert refused.value.response.status_code == 403


def live(mapper):
    return f"ws://{mapper.http.base_url.netloc.decode()}/ws"
