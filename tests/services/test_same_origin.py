"""Pages of other origins cannot make a browser change anything on the mapper; programs and its page can."""

import httpx
import pytest


def post(mapper, path, headers, method="POST"):
    host = mapper.http.base_url.netloc.decode()
    sent = {name: value.format(host=host) for name, value in headers.items()}
    return mapper.http.request(method, path, headers=sent)


@pytest.mark.parametrize(
    "headers",
    [
        {"Sec-Fetch-Site": "cross-site", "Origin": "http://evil.example"},
        {"Sec-Fetch-Site": "same-site", "Origin": "http://127.0.0.1:1"},
        {"Sec-Fetch-Site": "cross-site"},
        {"Sec-Fetch-Site": "cross-site", "Origin": "http://{host}"},
        {"Sec-Fetch-Site": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "http://127.0.0.1:1"},
        {"Origin": "http://evil.example/{host}"},
        {"Origin": "http://{host}.evil.example"},
        {"Origin": "null"},
        {"Origin": ""},
    ],
)
def test_a_page_of_another_origin_cannot_empty_the_map(cross, headers):
    before = cross.status()
    for path in ("/reset", "/reset?x=1", "/map.png", "/nowhere"):
        response = post(cross, path, headers)
        assert response.status_code == 403
        assert response.headers["content-type"] == "application/problem+json"
        assert response.headers["cache-control"] == "no-store"
        body = response.json()
        assert (body["type"], body["status"], body["title"]) == ("cross-origin", 403, "Forbidden")
        assert body["detail"].startswith(f"POST {path.partition('?')[0]}: refused: a page of another")
        assert "a program that is no browser" in body["detail"]
    for path in ("/save?name=a", "/restore?name=a"):
        assert post(cross, path, headers).status_code == 403
    assert post(cross, "/snapshots/a", headers, method="DELETE").status_code == 403
    after = cross.status()
    assert (after["epoch"], after["revision"]) == (before["epoch"], 3)


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"Sec-Fetch-Site": "same-origin", "Origin": "http://{host}"},
        {"Sec-Fetch-Site": "same-origin"},
        {"Sec-Fetch-Site": "none"},
        {"Origin": "http://{host}"},
        {"Origin": "https://{host}"},
        {"Origin": "http://LocalHost:80", "Host": "localhost:80"},
    ],
)
def test_programs_and_its_own_page_can(mapper, headers):
    epoch = mapper.draw_cross()["epoch"]
    status = post(mapper, "/reset", headers).raise_for_status().json()
    assert status["epoch"] != epoch
    assert status["revision"] == 0


def test_every_page_may_look(cross):
    headers = {"Sec-Fetch-Site": "cross-site", "Origin": "http://evil.example"}
    for method in ("GET", "HEAD"):
        response = cross.http.request(method, "/map.png", headers=headers)
        assert response.status_code == httpx.codes.OK
        assert int(response.headers["ogm-revision"]) == 3
