"""HEAD, OPTIONS and Allow: on every route that there is, and of every method that it does not take."""

import re

import pytest

METHODS = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "MERGE"}
UNDESCRIBED = ["/docs", "/openapi.json", "/static-offline-docs/swagger-ui.css"]
ASKED = {"/cell": "?x=0&y=0", "/raycast": "?x=0.25&y=0.25&theta=0&range_max=1", "/inflate": "?radius=1"}


def paths_of(mapper):
    """Every path that is served, with the methods that are described, and HEAD and OPTIONS."""
    document = mapper.http.get("/openapi.json").json()["paths"]
    found = {path: {method.upper() for method in item} for path, item in document.items()}
    found |= {path: {"GET"} for path in UNDESCRIBED}
    place = {"z": 16, "x": 0, "y": -1, "name": "of-none", "robot": "nobody"}
    return {
        path.format(**place): methods | {"OPTIONS"} | ({"HEAD"} if "GET" in methods else set())
        for path, methods in found.items()
    }


def asked(path):
    return path + next((query for begin, query in ASKED.items() if path.startswith(begin)), "")


def allow(response):
    methods = response.headers["allow"].split(", ")
    assert methods == sorted(set(methods))
    return set(methods)


def test_options_name_what_a_path_takes_and_change_nothing(cross):
    epoch = cross.status()["epoch"]
    for path, methods in paths_of(cross).items():
        response = cross.http.options(asked(path))
        assert (response.status_code, response.content) == (204, b""), path
        assert allow(response) == methods
        assert "content-length" not in response.headers
    assert cross.status()["epoch"] == epoch
    assert cross.http.options("/nowhere").status_code == 404


def test_any_other_method_is_refused_with_what_a_path_takes(cross):
    epoch = cross.status()["epoch"]
    for path, methods in paths_of(cross).items():
        for method in METHODS - methods:
            response = cross.http.request(method, path)
            assert response.status_code == 405, (method, path)
            assert allow(response) == methods
            assert response.headers["content-type"] == "application/problem+json"
            assert response.headers["cache-control"] == "no-store"
            if method != "HEAD":
                detail = response.json()["detail"]
                assert detail == f"{method} is not for {path}: {', '.join(sorted(methods))} are"
    assert cross.status()["epoch"] == epoch


CHANGING = re.compile(r"/(status|metrics|quality)$")


def test_head_is_get_without_its_body(cross):
    for path, methods in paths_of(cross).items():
        if "GET" not in methods:
            continue
        whole = cross.http.get(asked(path))
        for _ in range(2):  # the second time it is ready
            head = cross.http.head(asked(path))
            assert (head.status_code, head.content) == (whole.status_code, b""), path
            given, wanted = dict(head.headers), dict(whole.headers)
            del given["date"], wanted["date"]
            if CHANGING.search(path):
                # Longer or shorter by a few digits, so maybe worth compressing at one time only.
                assert int(given.pop("content-length")) > 0
                for headers in (given, wanted):
                    headers.pop("content-length", None)
                    headers.pop("content-encoding", None)
            assert given == wanted
        if "etag" in whole.headers:
            known = cross.http.head(asked(path), headers={"If-None-Match": whole.headers["etag"]})
            assert (known.status_code, known.headers["etag"]) == (304, whole.headers["etag"])


@pytest.mark.parametrize("path", ["/nowhere", "/cell?x=0", "/map.png?no=1", "/tiles/3/0/0.png"])
def test_head_of_what_is_refused_is_refused(cross, path):
    whole, head = cross.http.get(path), cross.http.head(path)
    assert (head.status_code, head.content) == (whole.status_code, b"")
    assert head.status_code in (400, 404)
    assert head.headers["content-length"] == whole.headers["content-length"]


def test_a_connection_goes_on_after_head_and_options(cross):
    for method in ("HEAD", "OPTIONS", "GET") * 3:
        assert cross.http.request(method, "/map.json").is_success
