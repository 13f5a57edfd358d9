"""Maps over HTTP that have not changed, are no longer the one wanted, or are sent again as they are."""

import json
import zlib

import pytest
import yaml

from ogm_services.mapper.serving import map_formats

FORMATS = ("png", "json", "pgm", "yaml", "npz", "pgw")


def problem(response, status, slug):
    """The detail of a problem+json answer that no cache may keep."""
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    body = response.json()
    assert (response.status_code, body["status"], body["type"]) == (status, status, slug)
    return body["detail"]


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        ("{etag}", 304),
        ("W/{etag}", 304),
        ('"other", {etag}', 304),
        ('"other",W/{etag} , "x"', 304),
        ("*", 304),
        ('"other"', 200),
        ('"other"\n{etag}', 304),
        ('{etag}\n"other"', 304),
        ('"other"\n*', 304),
        ('"-3"', 200),
        ('"a\n"b"', 200),
        ('"other,*"', 200),
        ("", 200),
    ],
)
def test_not_modified(cross, sent, status):
    for form in FORMATS:
        whole = cross.http.get(f"/map.{form}")
        lines = sent.format(etag=whole.headers["etag"]).split("\n")
        headers = [("If-None-Match", line) for line in lines]
        response = cross.http.get(f"/map.{form}", headers=headers)
        assert response.status_code == status
        assert response.content == (whole.content if status == 200 else b"")
        for name in ("etag", "cache-control", "ogm-epoch", "ogm-run", "ogm-revision", "ogm-stamp"):
            assert response.headers[name] == whole.headers[name]


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        ("{etag}", 200),
        ('"other", {etag}', 200),
        ('"other"\n{etag}', 200),
        ("*", 200),
        ('"other"', 412),
        ("W/{etag}", 412),  # a weak one may stand for other bytes
        ('W/"a", "b"', 412),
        ("", 412),
    ],
)
def test_a_map_is_sent_only_if_it_is_the_one_that_is_wanted(cross, sent, status):
    for form in FORMATS:
        whole = cross.http.get(f"/map.{form}")
        lines = sent.format(etag=whole.headers["etag"]).split("\n")
        for query in ("", "?region=-9,-9,9,9", "?region=-9,-9,9,9&t=1"):
            plain = cross.http.get(f"/map.{form}{query}")
            response = cross.http.get(f"/map.{form}{query}", headers=[("If-Match", line) for line in lines])
            if status == 412:
                assert whole.headers["etag"] in problem(response, 412, "map-changed")
            else:
                assert (response.status_code, response.content) == (200, plain.content)


def test_what_is_wanted_is_looked_at_before_what_is_known(cross):
    etag = cross.http.get("/map.yaml").headers["etag"]
    for wanted, known, status in ((etag, etag, 304), ('"no"', etag, 412), ('"no"', '"no"', 412)):
        headers = {"If-Match": wanted, "If-None-Match": known}
        assert cross.http.get("/map.yaml", headers=headers).status_code == status


def test_yaml_and_pgm_fetched_by_hand_are_one_map_or_refused(mapper):
    """A scan comes between the two requests: without If-Match a new picture would meet an old origin."""
    mapper.draw_cross()
    first = mapper.http.get("/map.yaml")
    pair = {"If-Match": first.headers["etag"]}
    picture = mapper.http.get("/map.pgm", headers=pair).raise_for_status()
    assert yaml.safe_load(first.content)["crc32"] == zlib.crc32(picture.content)
    mapper.scan([2.4], pose=[3.0, 0.25, 0.0], at=9)
    mapper.settle(received=4)
    for _ in range(2):
        assert "begin again" in problem(mapper.http.get("/map.pgm", headers=pair), 412, "map-changed")
        mapper.http.get("/map.pgm").raise_for_status()


def test_what_a_viewer_adds_against_caches_is_not_heard(cross, monkeypatch):
    encoded = []
    npz = map_formats.encode_npz
    monkeypatch.setattr(map_formats, "encode_npz", lambda *given: (encoded.append(1), npz(*given))[1])
    for k in range(5):
        cross.http.get(f"/map.npz?region=-1,-1,1.{k // 4},1&t={k}").raise_for_status()
    assert len(encoded) == 2, "once a map, not once a request"
    for path in ("/map.png", "/map.json?values=trinary", "/map.yaml?region=0,0,1,1", "/cell?x=0&y=0"):
        join = "&" if "?" in path else "?"
        plain = cross.http.get(path)
        for added in ("t=1764345600", "t=", "t", "t=1&t=2", "%74=5"):
            for url in (f"{path}{join}{added}", path.replace("?", f"?{added}&")):
                assert cross.http.get(url).content == plain.content, url
    assert cross.http.get("/status?t=1").status_code == 200
    assert "T: unknown" in problem(cross.http.get("/map.png?T=1"), 400, "bad-parameter")


def test_a_bad_request_is_told_even_if_the_map_is_not_modified(cross):
    problem(cross.http.get("/map.png?no=1", headers={"If-None-Match": "*"}), 400, "bad-parameter")


def test_a_new_scan_is_a_new_revision_and_etag(mapper):
    mapper.draw_cross()
    before = mapper.http.get("/map.json")
    mapper.scan([1.0], pose=[0, 0, 0], at=-5)
    mapper.settle(received=4)
    after = mapper.http.get("/map.json", headers={"If-None-Match": before.headers["etag"]})
    assert (after.status_code, json.loads(after.content)["revision"]) == (200, 4)
    assert after.headers["ogm-stamp"] == before.headers["ogm-stamp"]  # the largest integrated, not the last


def test_a_map_that_is_sent_again_is_the_same_in_every_respect(cross):
    """The first answer comes from a route, those after it from what is ready to be sent."""
    for form in FORMATS:
        for method in ("GET", "HEAD"):
            for tag in ({}, {"If-None-Match": "*"}, {"If-None-Match": '"no"'}):
                # A query that was not asked yet has nothing ready.
                query = f"region=-9,-9,9,{9 + len(form)}.{len(tag)}{len(method)}{len(str(tag))}"
                again = [cross.http.request(method, f"/map.{form}?{query}", headers=tag) for _ in range(3)]
                seen = {
                    (
                        response.status_code,
                        response.content,
                        *(item for item in response.headers.multi_items() if item[0] != "date"),
                    )
                    for response in again
                }
                assert len(seen) == 1, (form, method, tag)


def test_a_map_that_is_ready_is_not_the_answer_to_other_methods(cross):
    for _ in range(2):
        assert cross.http.get("/map.png").status_code == 200
    assert cross.http.post("/map.png").status_code == 405


def test_a_map_is_sent_again_only_as_long_as_it_does_not_change(mapper):
    mapper.draw_cross()
    first = mapper.http.get("/map.png")
    assert mapper.http.get("/map.png").content == first.content
    mapper.scan([1.0], pose=[0, 0, 0], at=9)
    mapper.settle(received=4)
    for _ in range(2):
        after = mapper.http.get("/map.png", headers={"If-None-Match": first.headers["etag"]})
        assert (after.status_code, after.headers["ogm-revision"]) == (200, "4")
    mapper.http.post("/reset")
    for _ in range(2):
        assert mapper.http.get("/map.png").status_code == 404
