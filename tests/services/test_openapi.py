"""What /openapi.json says: that it is well-formed and whole, and that every status it names is given so."""

import json
import re
from collections import defaultdict
from pathlib import Path
from urllib.parse import quote

import httpx
import pytest
from jsonschema import ValidationError
from openapi_spec_validator import OpenAPIV31SpecValidator

from described_http import check, document, operation_of, validator
from ogm_core.errors import BadInput, BadSetting, BadStore, DiskFull, MapEmpty, OgmError, UnknownRobot
from ogm_services.mapper.serving.guesses import AT_ONCE
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.replies import answer as answer_module
from ogm_services.replies.answer import Starting
from ogm_services.replies.problems import slug_of, status_of

TOKEN = "secret-of-the-mapper"
OF_A_PROBE = {"/livez", "/readyz"}
ASKED = {
    "/cell": "?x=0&y=0",
    "/inflate.png": "?radius=1",
    "/inflate.npz": "?radius=1",
    "/raycast": "?x=0.25&y=0.25",
    "/erase": "?region=-9,-9,9,9",
    "/save": "?name=new",
    "/restore": "?name=here",
}
"""Queries without which routes answer 400."""
PLACES = {"z": 16, "x": 0, "y": 0, "name": "here", "robot": "r"}
OF_SAVED_MAPS = "/map.", "/distance.", "/inflate."
UNNAMED = {"/restore": "?name=nowhere"}


def operations():
    """Every operation of the document: its path, its method, and what is said of it."""
    return [
        (path, method, told) for path, item in document()["paths"].items() for method, told in item.items()
    ]


def ask(http, path, method, *, query=None, **options):
    """Ask a route for what it has; `query` in place of the one that it needs."""
    if path == "/check":
        options = {"json": {"points": [[0.0, 0.0]]}} | options
    if path == "/login" and method == "post":
        options = {"json": {"token": "not-that-of-the-mapper"}} | options
    url = path.format(**PLACES) + (ASKED.get(path, "") if query is None else query)
    return http.request(method, url, **options)


def test_the_document_is_valid():
    OpenAPIV31SpecValidator(document()).validate()


def test_every_operation_is_named_told_of_and_shown_by_examples():
    ids, tags = [], {tag["name"] for tag in document()["tags"]}
    for path, method, told in operations():
        where = f"{method} {path}"
        ids.append(told["operationId"])
        assert re.fullmatch("[a-z]+(_[a-z]+)*", ids[-1]), where
        assert len(told["tags"]) == 1, where
        assert set(told["tags"]) <= tags, where
        assert told["summary"], where
        for parameter in told.get("parameters", []):
            schema = parameter["schema"]
            assert parameter["description"], (where, parameter["name"])
            (example,) = schema["examples"]
            validator(schema).validate(example)
            assert parameter.get("example", example) == example
            # In /docs, which takes < > for HTML and shows no example of a schema, but a default or a word.
            assert "<" not in parameter["description"], (where, parameter["name"])
            shown = {"default", "example"} & {*schema, *parameter}
            assert shown or f"`{example}`" in parameter["description"], (where, parameter["name"])
        for answer in told["responses"].values():
            assert not any("<" in header["description"] for header in answer.get("headers", {}).values())
        for status, answer in told["responses"].items():
            if status == "304" or (path in OF_A_PROBE and status in ("200", "503")):
                continue
            (media_type,) = answer["content"]
            problem = answer["content"][media_type]["schema"] == {"$ref": "#/components/schemas/Problem"}
            assert problem == (media_type == "application/problem+json") == (status != "200"), (where, status)
    assert len(ids) == len(set(ids))


def test_every_status_that_is_described_is_given(start_mapper, tmp_path, monkeypatch):
    """DescribedClient compares each of these answers with the description."""
    given = defaultdict(set)

    def heard(response):
        request = response.request
        operation, path = operation_of(request.method, request.url.path)
        if operation is not None:
            given[path, request.method.lower()].add(str(response.status_code))

    with start_mapper() as mapper:
        mapper.http.event_hooks = {"response": [heard]}
        assert mapper.http.delete("/robots/r").status_code == 409
    settings = {"map": {"resolution": 0.5, "cell_model": "rate"}, "mapper": {"separate_robots": True}}
    settings["mapper"]["data"] = tmp_path
    with start_mapper(**settings) as mapper:
        mapper.http.event_hooks = {"response": [heard]}
        refused_by_all(mapper.http)
        unlike_any_map(mapper.http)
        mapper.draw_cross()
        assert mapper.http.post("/save?name=here").status_code == 200
        assert mapper.http.post("/save?name=here").status_code == 409
        answered(mapper.http)
        mapper.service.answers._ready = lambda: False
        fails_now(mapper, monkeypatch)
    with start_mapper(http={"token": TOKEN}) as mapper:
        mapper.http.event_hooks = {"response": [heard]}
        for path, method, told in operations():
            assert ("security" in told) == ("401" in told["responses"] and path != "/login")
            if "401" in told["responses"]:
                assert ask(mapper.http, path, method).status_code == 401
        for _ in range(AT_ONCE):
            ask(mapper.http, "/login", "post")
        for path, method, told in operations():
            if "429" in told["responses"]:
                wrong = {"Authorization": "Bearer not-that-of-the-mapper"}
                assert ask(mapper.http, path, method, headers=wrong).status_code == 429
    described = {(path, method): set(told["responses"]) - {"default"} for path, method, told in operations()}
    # These look at nothing that could fail.
    for path in ("/", "/livez", "/readyz", "/version", "/login", "/logout"):
        for method in document()["paths"][path]:
            described[path, method].remove("500")
    assert given == described


def refused_by_all(http):
    """What is wrong whatever is asked, or wherever something is written."""
    for path, method, _ in operations():
        assert ask(http, path, method, headers={"Host": "elsewhere.org"}).status_code == 421
        assert ask(http, path, method, headers={"Host": "a@b"}).status_code == 400
        if method != "get":
            assert ask(http, path, method, headers={"Sec-Fetch-Site": "cross-site"}).status_code == 403
            assert ask(http, path, method, content=bytes(100_000)).status_code == 413


def unlike_any_map(http):
    """What is not there, while there is no map."""
    for path, method, told in operations():
        if "404" in told["responses"]:
            query = UNNAMED.get(path) or (
                f"{ASKED.get(path, '?t=0')}&at=nowhere" if path.startswith(OF_SAVED_MAPS) else None
            )
            ask(http, path.replace("{z}", "9"), method, query=query)


def answered(http):
    """What goes well, with every validator; the map is emptied in the end, and a snapshot deleted."""
    last = ("/restore", "/snapshots/{name}", "/erase", "/robots/{robot}", "/reset")
    for path, method, told in sorted(
        operations(), key=lambda one: last.index(one[0]) if one[0] in last else -1
    ):
        if "304" in told["responses"]:
            assert ask(http, path, method, headers={"If-None-Match": "*"}).status_code == 304
            assert ask(http, path, method, headers={"If-Match": '"another"'}).status_code == 412
        if path != "/snapshots/{name}":
            assert ask(http, path, method).status_code == 200, path
    assert http.delete("/snapshots/new").status_code == 200


def fails_now(mapper, monkeypatch):
    """What is wrong with the mapper itself."""
    monkeypatch.setattr(Health, "not_alive", lambda _: "it is dead")
    for error, status in (
        (Starting("now"), 503),
        (DiskFull("of logs"), 507),
        (ZeroDivisionError("a bug"), 500),
    ):

        def fail(error=error):
            raise error

        mapper.service.answers._ready = fail
        for path, method, told in operations():
            if str(status) in told["responses"]:
                # A connection of its own: after a bug it is closed.
                ask(mapper.http, path, method, headers={"Connection": "close"})


def test_examples_are_taken(cross):
    for path, method, told in operations():
        needed = ASKED.get(path, "?t=0")
        for parameter in told.get("parameters", []):
            name, (example,) = parameter["name"], parameter["schema"]["examples"]
            if method == "get" and parameter["in"] == "query" and f"{name}=" not in needed:
                response = ask(cross.http, path, method, query=f"{needed}&{name}={quote(str(example))}")
                # It stores no map, and so there is none of any name.
                assert response.status_code == (503 if name == "at" else 200), response.url


def answer(path="/cell", status=200, **fields):
    """What a mapper might say, with these fields in place of some of a cell's."""
    cell = {"x": 0.0, "y": 0.0, "ix": 0, "iy": 0, "known": False, "log_odds": None, "probability": None}
    said = {name: value for name, value in (cell | fields).items() if value is not ...}
    request = httpx.Request("GET", f"http://mapper{path}")
    return request, httpx.Response(
        status, content=json.dumps(said), headers={"Content-Type": "application/json"}, request=request
    )


@pytest.mark.parametrize(
    ("wrong", "error"),
    [
        (answer(ix=0.5), ValidationError),
        (answer(known=None), ValidationError),
        (answer(probability=...), ValidationError),
        (answer(more=1), ValidationError),
        (answer(status=201), AssertionError),
        (answer(status=400), AssertionError),
        (answer("/nowhere"), AssertionError),
        (answer("/map.json"), AssertionError),
        (answer("/version"), ValidationError),
        (answer(x=float("nan")), ValueError),
    ],
)
def test_an_answer_that_is_not_as_described_is_noticed(wrong, error):
    check(*answer())
    with pytest.raises(error):
        check(*wrong)


def test_the_table_of_errors_has_all_that_can_be_told():
    page = Path(__file__).parents[2].joinpath("docs", "http.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| ([0-9]{3}) \| `([a-z-]+)` \|", page, re.MULTILINE)
    named = [kind for kind in vars(answer_module).values() if isinstance(kind, type)]
    kinds = [kind for kind in named if issubclass(kind, OgmError) and kind not in (OgmError, BadInput)]
    kinds += [BadSetting, MapEmpty, UnknownRobot, BadStore, StoreFails, DiskFull]
    told = {(status_of(kind.__new__(kind)), kind.slug) for kind in kinds}
    told |= {(status, slug_of(status)) for status in (400, 404, 405, 408, 413, 414, 431)}
    told.add((500, "internal"))
    assert len(rows) == len(told)
    assert {(int(status), slug) for status, slug in rows} == told
