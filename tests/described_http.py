"""An HTTP client that holds every answer of a mapper to what its OpenAPI document says of the route."""

import json
import re
from functools import cache, partial
from itertools import islice
from unittest.mock import MagicMock

import httpx
from jsonschema import Draft202012Validator

from ogm_core.cells.thresholds import FREE_BELOW
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.http_routes import build_app

SHOWN = 50
"""So many items of a list, or by name, are looked at: they are alike, and a map has millions."""
BEYOND = {"/docs", "/docs/oauth2-redirect", "/openapi.json"}
"""What is served besides the routes that are described, and FILES of /docs and of the page."""
FILES = "/static-offline-docs/", "/static/"
BEFORE_A_ROUTE = {405, 408, 413, 414, 431}


class DescribedClient(httpx.Client):
    """A client that fails where an answer is not as it is described; `under`: the mapper's root path."""

    def __init__(self, *, under="", **options):
        super().__init__(**options)
        self._under = under

    def send(self, request, *, stream=False, **options):
        response = super().send(request, stream=stream, **options)
        if not stream:
            check(request, response, request.headers.get("X-Forwarded-Prefix", self._under).rstrip("/"))
        return response


@cache
def document():
    """The description, made without a mapper: it is the same of each."""
    answers = MagicMock(free_below=FREE_BELOW, map_parameters=partial(Answers.map_parameters, None))
    app = build_app(answers, *[MagicMock()] * 3, access=HttpAccess(), threads=MagicMock())
    return json.loads(json.dumps(app.openapi()))


@cache
def _templates():
    return [(re.compile(re.sub(r"\{\w+\}", "[^/]+", path)), path) for path in document()["paths"]]


def operation_of(method, path):
    """The operation that is asked, and its path's template; None: there is none."""
    for pattern, template in _templates():
        if pattern.fullmatch(path):
            item = document()["paths"][template]
            return item.get("get" if method == "HEAD" else method.lower()), template
    return None, None


def check(request, response, under=""):
    """Look at the status, the headers, the media type and the body of an answer; `under`: a proxy's path."""
    method, path = request.method, request.url.path
    # The mapper need not believe in the path: then there is nothing under it.
    if response.status_code != 404 and (path == under or path.startswith(f"{under}/")):
        path = path.removeprefix(under)
    operation, _ = operation_of(method, path)
    if operation is None:
        if response.status_code < 400:
            led_on = response.status_code == 307
            assert led_on or method == "OPTIONS" or path in BEYOND or path.startswith(FILES), request.url
            return
        described = document()["paths"]["/status"]["get"]["responses"]["default"]
    elif (status := str(response.status_code)) in operation["responses"]:
        described = operation["responses"][status]
    else:
        assert response.status_code in BEFORE_A_ROUTE, f"{method} {path}: {status} is not described"
        described = operation["responses"]["default"]
    for name, header in described.get("headers", {}).items():
        assert name in response.headers or not header["required"], f"{method} {path}: without {name}"
    if "content" in described and method != "HEAD":
        ((media_type, content),) = described["content"].items()
        assert response.headers["content-type"].partition(";")[0] == media_type, f"{method} {path}"
        if media_type.endswith("json"):
            validator(content["schema"]).validate(
                _shortened(json.loads(response.content, parse_constant=_none))
            )
    else:
        assert not response.content


def validator(schema):
    """What says whether JSON is as it is described: all that it has is described, too."""
    return _validator(json.dumps(schema))


@cache
def _validator(schema):
    components = json.loads(json.dumps(document()["components"]))
    for model in components["schemas"].values():
        if "properties" in model:
            model["additionalProperties"] = False
    return Draft202012Validator({**json.loads(schema), "components": components})


def _shortened(value):
    if isinstance(value, list):
        return [_shortened(item) for item in value[:SHOWN]]
    if isinstance(value, dict):
        return {name: _shortened(item) for name, item in islice(value.items(), SHOWN)}
    return value


def _none(constant):
    raise ValueError(f"{constant} is no JSON")
