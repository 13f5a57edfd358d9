"""Content coding: text goes by gzip to who takes it, with validators that say so, and is packed once."""

import gzip
import json
import re
import tracemalloc

import httpx
import pytest

from ogm_core.units import MEBIBYTE
from ogm_services.mapper.serving import ready_maps as ready_maps_module
from ogm_services.mapper.serving.content_coding import MIN_BYTES, accepted, gzipped, is_text
from ogm_services.mapper.serving.known_hosts import OwnNames

GZIP = {"Accept-Encoding": "gzip"}
AS_IT_IS = {"Accept-Encoding": "identity"}
UNKNOWN = {"Accept-Encoding": "br, gzip;q=0"}


@pytest.fixture(scope="module")
def large(start_mapper):
    """A mapper whose map.json is longer than MIN_BYTES, and a saved map."""
    with start_mapper(map={"resolution": 0.02}) as mapper:
        mapper.scan([2.0, 1.5, 1.0], pose=[0.0, 0.0, 0.0], at=1, angle_increment=1.5, range_max=2.5)
        mapper.settle(received=1)
        yield mapper


def raw(mapper, path, headers, method="GET"):
    """A response and its body as it came, packed or not."""
    with mapper.http.stream(method, path, headers=headers) as response:
        return response, b"".join(response.iter_raw())


@pytest.mark.parametrize(
    ("given", "by_gzip", "identity"),
    [
        ("", False, True),
        ("gzip", True, True),
        ("GZip, deflate, br, zstd", True, True),
        ("x-gzip", True, True),
        ("deflate, br", False, True),
        ("*", True, True),
        ("gzip;q=0", False, True),
        ("gzip;q=0.000", False, True),
        ("gzip;q=0.001", True, True),
        ("gzip ; q=0.5", True, True),
        ("gzip;Q=1.000", True, True),
        ("*;q=0", False, False),
        ("gzip, *;q=0", True, False),
        ("gzip;q=0, *", False, True),
        ("identity", False, True),
        ("identity, gzip", True, True),
        ("identity;q=1, gzip;q=0.5", False, True),
        ("identity;q=0.5, gzip;q=1", True, True),
        ("identity;q=0", False, False),
        ("gzip, identity;q=0", True, False),
        ("identity, *;q=0", False, True),
        ("gzip;q=1.001", False, True),
        ("gzip;q=2", False, True),
        ("gzip;q=-1", False, True),
        ("gzip;q=", False, True),
        ("gzip;level=9", False, True),
        ("gzip;q=0.5;q=1", False, True),
        ("notgzip, gzipped", False, True),
        ("g zip", False, True),
        (",,, gzip ,", True, True),
        ("\xff\xfe, gzip", True, True),
    ],
)
def test_what_is_accepted(given, by_gzip, identity):
    assert accepted(given.encode("latin-1")) == (by_gzip, identity)


@pytest.mark.parametrize("read", [accepted, OwnNames().problem], ids=["Accept-Encoding", "Host"])
def test_headers_of_any_length_are_read_and_none_that_is_long_is_kept(read):
    tracemalloc.start()
    try:
        for number in range(100):
            assert read(b"gzip;q=0, x%d" % number + b"a" * 50_000)
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < MEBIBYTE


@pytest.mark.parametrize("name", ["json", "yaml", "pgm"])
def test_a_map_that_is_text_goes_by_gzip_to_who_takes_it(large, name):
    path = f"/map.{name}"
    plain, body = raw(large, path, AS_IT_IS)
    assert "content-encoding" not in plain.headers
    for _ in range(2):  # the second time it is ready
        packed, content = raw(large, path, GZIP)
        if len(body) < MIN_BYTES:
            assert (content, packed.headers["etag"]) == (body, plain.headers["etag"])
            continue
        assert packed.headers["content-encoding"] == "gzip"
        assert int(packed.headers["content-length"]) == len(content) < len(body) // 10
        assert gzip.decompress(content) == body
        assert packed.headers["etag"] == f'{plain.headers["etag"][:-1]};gzip"'
        same = [name for name in plain.headers if name not in ("etag", "content-length", "date")]
        assert [packed.headers[name] for name in same] == [plain.headers[name] for name in same]
        again, unpacked = raw(large, path, AS_IT_IS)
        assert (unpacked, again.headers["etag"]) == (body, plain.headers["etag"])
    assert plain.headers["vary"] == packed.headers["vary"] == "Accept-Encoding"


def test_many_lines_are_one_list(large):
    headers = [("Accept-Encoding", "identity;q=0.5"), ("Accept-Encoding", "gzip")]
    assert raw(large, "/map.json", headers)[0].headers["content-encoding"] == "gzip"


@pytest.mark.parametrize("path", ["/map.png", "/map.npz", "/map.tiles", "/tiles/16/0/-1.png"])
def test_what_is_packed_already_goes_as_it_is(large, path):
    plain, body = raw(large, path, AS_IT_IS)
    other, content = raw(large, path, {"Accept-Encoding": "gzip, identity;q=0"})
    assert content == body
    assert other.headers["etag"] == plain.headers["etag"]
    packed = f'{plain.headers["etag"][:-1]};gzip"'
    assert raw(large, path, GZIP | {"If-None-Match": packed})[0].status_code == 200
    assert {"content-encoding", "vary"} & {*plain.headers, *other.headers} == set()


def page_file(mapper):
    return "/" + re.search(r'(static/[^"]+\.css)"', mapper.http.get("/").text)[1]


@pytest.mark.parametrize("path", ["/", "/openapi.json", "/status", "/metrics", page_file])
def test_other_text_goes_by_gzip_if_it_is_long(large, path):
    path = path if isinstance(path, str) else path(large)
    for method in ("GET", "HEAD"):
        response, content = raw(large, path, GZIP, method)
        plain, body = raw(large, path, AS_IT_IS, method)
        assert response.headers["vary"] == plain.headers["vary"] == "Accept-Encoding"
        assert response.headers["content-type"] == plain.headers["content-type"]
        assert "content-encoding" not in plain.headers
        if int(plain.headers["content-length"]) < MIN_BYTES:
            assert "content-encoding" not in response.headers
            continue
        assert response.headers["content-encoding"] == "gzip"
        if method == "GET":
            assert int(response.headers["content-length"]) == len(content) < len(body)
            unpacked = gzip.decompress(content)
            assert path in ("/status", "/metrics") or unpacked == body


def test_who_takes_nothing_as_it_is_gets_short_text_by_gzip(large):
    for path in ("/map.yaml", "/version"):
        response, content = raw(large, path, {"Accept-Encoding": "gzip, identity;q=0"})
        assert response.headers["content-encoding"] == "gzip"
        assert gzip.decompress(content) == raw(large, path, AS_IT_IS)[1]
    assert "content-encoding" not in raw(large, "/version", GZIP)[0].headers


@pytest.mark.parametrize("weak", ["", "W/"])
@pytest.mark.parametrize("takes", [GZIP, AS_IT_IS, UNKNOWN])
def test_a_validator_of_either_coding_is_known(large, weak, takes):
    plain = raw(large, "/map.json", AS_IT_IS)[0].headers["etag"]
    packed = raw(large, "/map.json", GZIP)[0].headers["etag"]
    own = packed if takes is GZIP else plain
    for known, told in ((plain, plain), (packed, packed), (f"{plain}, {packed}", own), ("*", own)):
        given = known if known == "*" else ", ".join(weak + tag for tag in known.split(", "))
        response, body = raw(large, "/map.json", takes | {"If-None-Match": given})
        assert (response.status_code, body, response.headers["etag"]) == (304, b"", told)
        assert response.headers["vary"] == "Accept-Encoding"
        assert "content-encoding" not in response.headers
    for other in ('"x"', '"x;gzip"', f'{plain[:-1]};gzip;gzip"', f'{plain[:-1]};br"', plain[:-2] + '"'):
        response, body = raw(large, "/map.json", takes | {"If-None-Match": other})
        assert (response.status_code, response.headers["etag"]) == (200, own)


def test_a_pair_is_fetched_by_the_validator_of_either_coding(large):
    tags = [raw(large, "/map.json", takes)[0].headers["etag"] for takes in (GZIP, AS_IT_IS)]
    assert len(set(tags)) == 2
    for path in ("/map.yaml", "/map.pgm", "/map.png"):
        for tag in tags:
            assert large.http.get(path, headers={"If-Match": tag}).status_code == 200
            assert large.http.get(path, headers={"If-Match": f"W/{tag}"}).status_code == 412
            other = tag.replace("-1", "-2")
            assert large.http.get(path, headers={"If-Match": other}).status_code == 412


def test_a_map_is_packed_once_and_not_before_somebody_takes_it(large, monkeypatch):
    packed = []
    monkeypatch.setattr(ready_maps_module, "gzipped", lambda body: packed.append(len(body)) or gzipped(body))
    path = "/map.json?region=-1,-1,1,1"
    for takes, times in ((AS_IT_IS, 0), (UNKNOWN, 0), (GZIP, 1), (GZIP, 1), (AS_IT_IS, 1), (GZIP, 1)):
        body = raw(large, path, takes)[1]
        assert json.loads(gzip.decompress(body) if takes is GZIP else body)["width"] == 100
        assert len(packed) == times


def test_a_map_that_is_saved_and_problems_that_are_long_go_by_gzip_too(start_mapper, tmp_path):
    with start_mapper(map={"resolution": 0.02}, mapper={"data": str(tmp_path / "map")}) as mapper:
        mapper.scan([2.0, 1.5, 1.0], pose=[0.0, 0.0, 0.0], at=1, angle_increment=1.5, range_max=2.5)
        mapper.settle(received=1)
        mapper.http.post("/save?name=a").raise_for_status()
        response, body = raw(mapper, "/map.json?at=a", GZIP)
        assert response.headers["content-encoding"] == "gzip"
        assert gzip.decompress(body) == raw(mapper, "/map.json?at=a", AS_IT_IS)[1]


def test_programs_of_the_client_ask_for_no_coding_and_browsers_get_the_same_map(large):
    with httpx.Client(base_url=large.http.base_url) as browser:
        assert browser.get("/map.json").json() == large.http.get("/map.json", headers=AS_IT_IS).json()


@pytest.mark.parametrize(
    ("media_type", "text"),
    [
        ("application/json", True),
        ("application/problem+json", True),
        ("text/html; charset=utf-8", True),
        ("text/javascript", True),
        ("application/yaml", True),
        ("image/x-portable-graymap", True),
        ("image/png", False),
        ("application/octet-stream", False),
        ("application/x-npz", False),
        ("application/vnd.ogm.tiles", False),
        ("application/jsonx", False),
        ("", False),
    ],
)
def test_text_is_told_by_its_media_type(media_type, text):
    assert is_text(media_type) is text
