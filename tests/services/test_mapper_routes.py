"""The mapper's other routes: status, quality, one cell, metrics, page, documentation, errors."""

import importlib.metadata
import math
import re
from urllib.parse import urljoin

import pytest
from prometheus_client.parser import text_string_to_metric_families

from ogm_core.placing.receipts import DROP_REASONS
from status_json import NO_POSES

HIT = math.log(0.7 / 0.3)
MAPS = ["/map.png", "/map.pgw", "/map.json", "/map.pgm", "/map.yaml", "/map.npz", "/map.tiles", "/tiles.json"]
ROUTES = [*MAPS, "/cell", "/quality", "/status", "/livez", "/readyz", "/metrics", "/version", "/"]
TILES = "/tiles/{z}/{x}/{y}.png"
LAYERS = ["/distance.png", "/distance.npz", "/inflate.png", "/inflate.npz"]
QUERIES = {"/raycast": "get", "/check": "post", **dict.fromkeys(LAYERS, "get")}
LOG_INS = {"/login": {"get", "post"}, "/logout": {"post"}}
VALIDATORS = {"If-Match", "If-None-Match"}
WRITES = {
    "/reset": "post",
    "/erase": "post",
    "/robots/{robot}": "delete",
    "/save": "post",
    "/restore": "post",
    "/snapshots/{name}": "delete",
}


def problem(response):
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert (body["status"], body["title"]) == (response.status_code, response.reason_phrase)
    return response.status_code, body["type"]


def test_only_maps_may_be_kept_by_a_cache(cross):
    others = [path for path in ROUTES if path not in MAPS]
    others[others.index("/cell")] = "/cell?x=0&y=0"
    others += ["/docs", "/openapi.json", "/static-offline-docs/swagger-ui.css", "/nothing", "/map.png?no=1"]
    for path in others:
        assert cross.http.get(path).headers["cache-control"] == "no-store", path
    assert cross.http.post("/status").headers["cache-control"] == "no-store"
    assert cross.http.post("/reset?no=1").headers["cache-control"] == "no-store"


@pytest.mark.parametrize(
    ("x", "y", "cell", "log_odds"),
    [
        (2.0, 0.0, (4, 0), 2 * HIT),
        (2.499999, 0.499999, (4, 0), 2 * HIT),
        (1.999999, 0.25, (3, 0), -2 * HIT),
        (0.25, -2.25, (0, -5), -HIT),
    ],
)
def test_a_known_cell(cross, x, y, cell, log_odds):
    reply = cross.http.get("/cell", params={"x": x, "y": y}).json()
    assert reply.pop("log_odds") == pytest.approx(log_odds, abs=1e-3)
    assert reply.pop("probability") == pytest.approx(1 / (1 + math.exp(-log_odds)), abs=1e-4)
    assert reply == {"x": x, "y": y, "ix": cell[0], "iy": cell[1], "known": True}


@pytest.mark.parametrize(
    ("x", "y", "cell"), [(0.25, 0.25, (0, 0)), (-1, 1, (-2, 2)), (1e6, -1e6, (2e6, -2e6))]
)
def test_an_unknown_cell_in_the_map_or_outside(cross, x, y, cell):
    assert cross.http.get("/cell", params={"x": x, "y": y}).json() == {
        "x": x,
        "y": y,
        "ix": cell[0],
        "iy": cell[1],
        "known": False,
        "log_odds": None,
        "probability": None,
    }


@pytest.mark.parametrize(
    "path",
    [
        "/cell",
        "/cell?x=1",
        "/cell?x=1&y=",
        "/cell?x=one&y=1",
        "/cell?x=1_0&y=1",
        "/cell?x=1&y=%D9%A1",
        "/cell?x=1&y=infinity",
        "/cell?x=nan&y=1",
        "/cell?x=1&y=inf",
        "/cell?x=1e300&y=1",
        "/cell?x=1&y=1&z=1",
        "/cell?x=1&x=1&y=1",
        "/status?no=1",
        "/quality?region=0,0,1,1",
    ],
)
def test_a_bad_parameter(cross, path):
    assert problem(cross.http.get(path)) == (400, "bad-parameter")


def test_status(cross):
    status = cross.status()
    assert list(status) == [
        *("map", "epoch", "revision", "stamp", "scans", "poses", "other", "map_info", "robots", "uptime_s"),
        *("run", "threads", "restored"),
    ]
    assert (status["threads"], status["restored"]) == (1, False)
    assert (status["map"], status["revision"], status["stamp"]) == ("hall", 3, 1_700_000_000_000_000_003)
    dropped, beside = dict.fromkeys(DROP_REASONS, 0), {"lost": 0, "replayed": 0, "beams_on_robots": 0}
    assert status["scans"] == {"received": 3, "integrated": 3, "pending": 0, "dropped": dropped} | beside
    assert status["poses"] == NO_POSES
    assert status["other"] == {"ignored": 0}
    source = {"run": "", "last_seq": 0, "received": 3, "pending": 0, "integrated": 3}
    source |= {"dropped": {}, "hints": [], "lost": 0, "beams_on_robots": 0}
    robot = {"pose": [0.25, 0.25, 0.0], "stamp": 1_700_000_000_000_000_003, "sources": {"s": source}}
    assert 0.0 <= status["robots"]["r"].pop("age_s") < 60.0
    assert status["robots"] == {"r": robot | {"alive": False}}
    assert {k: status["map_info"][k] for k in ("width", "height", "resolution")} == {
        "width": 7,
        "height": 9,
        "resolution": 0.5,
    }
    assert status["map_info"]["bytes"] > 0
    assert len(status["epoch"]) == len(status["run"]) == 32
    assert status["epoch"] != status["run"]
    assert 0 < status["uptime_s"] < cross.status()["uptime_s"] < 600


def test_known_cells_and_quality_become_those_of_the_newest_map(cross, eventually):
    eventually(lambda: cross.status()["map_info"]["known_cells"] == 14)
    quality = eventually(lambda: (q := cross.http.get("/quality").json())["scans"] == 3 and q)
    assert quality["known_m2"] == 14 * 0.25
    assert quality["occupied_m2"] == 3 * 0.25
    assert quality["free_m2"] == 6 * 0.25
    # Each hit end and each passed cell of the three scans, all of them on the right side of a half.
    assert quality["consistency"] == {"hits": 1.0, "free": 1.0}
    assert quality["cell_updates"] == 2 * 9 + 5
    p, q = 1 / (1 + math.exp(-2 * HIT)), 0.7
    entropy = -sum(n * (a * math.log2(a) + (1 - a) * math.log2(1 - a)) for n, a in ((9, p), (5, q)))
    assert quality["entropy_bits"] == pytest.approx(entropy, rel=1e-3)
    assert quality["mean_entropy_bits"] == pytest.approx(entropy / 14, rel=1e-3)


def test_metrics_are_prometheus_text_and_say_what_status_says(mapper):
    mapper.draw_cross()
    mapper.pose(), mapper.pose(), mapper.pose(x=math.nan)
    mapper.put("robots/r/odometry", b"")
    mapper.put("robots/r/scan/s", b"garbage")
    status = mapper.settle(received=4)
    response = mapper.http.get("/metrics")
    assert response.headers["content-type"].startswith("text/plain; version=0.0.4")
    samples = prometheus(response.text)
    scans, poses = status["scans"], status["poses"]
    assert samples.pop(("ogm_uptime_seconds",)) > status["uptime_s"]
    assert samples.pop(("ogm_map_known_cells",)) <= 14
    assert samples.pop(("ogm_robot_age_seconds", "r")) >= status["robots"]["r"]["age_s"]
    assert {reason[1]: samples.pop(("ogm_scans_dropped_total", reason[1])) for reason in list(samples)
            if reason[0] == "ogm_scans_dropped_total"} == scans["dropped"]  # fmt: skip
    assert samples == {
        ("ogm_scans_received_total",): scans["received"],
        ("ogm_scans_integrated_total",): scans["integrated"],
        ("ogm_scans_pending",): 0,
        ("ogm_poses_received_total",): poses["received"],
        ("ogm_poses_refused_total", "malformed"): poses["malformed"],
        ("ogm_poses_refused_total", "late"): poses["late"],
        ("ogm_poses_refused_total", "outlier"): 0,
        ("ogm_poses_refused_total", "superseded"): 0,
        ("ogm_poses_refused_total", "refused"): 0,
        ("ogm_poses_restarted_total",): 0,
        ("ogm_poses_ambiguous_total",): 0,
        **{(f"ogm_{of}_{what}_total",): 0 for of in ("scans", "poses") for what in ("lost", "replayed")},
        ("ogm_beams_on_robots_total",): 0,
        ("ogm_messages_ignored_total",): status["other"]["ignored"],
        ("ogm_map_revision",): 3,
        ("ogm_map_bytes",): status["map_info"]["bytes"],
        ("ogm_robots",): 1,
        ("ogm_robot_alive", "r"): 0,
        ("ogm_ready",): 1,
        ("ogm_robot_scans_received_total", "r"): 4,
        ("ogm_robot_scans_dropped_total", "r"): 1,
        ("ogm_robot_hints", "r"): 0,
    }
    assert (scans["dropped"]["malformed"], poses, status["other"]) == (
        1,
        NO_POSES | {"received": 3, "malformed": 1, "late": 1},
        {"ignored": 1},
    )


def prometheus(text):
    """Samples by name and labels of what the status says, too."""
    samples = {}
    for family in text_string_to_metric_families(text):
        for name, labels, value, *_ in family.samples:
            beyond = "process_", "ogm_build", "ogm_scan_", "ogm_http", "ogm_l", "ogm_queue", "ogm_memory"
            if not name.startswith(beyond):
                assert labels.pop("map") == "hall"
                samples[(name, *labels.values())] = value
    return samples


def test_version_and_page(cross):
    version = importlib.metadata.version("zenoh-ogm")
    assert cross.http.get("/version").json() == {"name": "zenoh-ogm", "version": version}
    page = cross.http.get("/")
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert re.findall(r"(?:https?:)?//[\w.-]+\.\w+", page.text) == []


def test_the_page_is_found_below_any_path_and_caches_keep_its_files_for_good(cross):
    page = cross.http.get("/")
    assert "default-src 'self';" in page.headers["content-security-policy"]
    assert "script-src" not in page.headers["content-security-policy"]
    addresses = re.findall(r"""(?:href|src)=["'](?!data:)([^"']+)["']""", page.text)
    assert len(addresses) >= 10
    loaded = [address for address in addresses if address.startswith("static/")]
    assert {address.rpartition("/")[2] for address in loaded} == {
        "leaflet.js",
        "leaflet.css",
        "main.js",
        "page.css",
        "panel.css",
    }
    for address in addresses:
        assert urljoin("/robots/", address).startswith("/robots/")
        answer = cross.http.get(urljoin("/", address)).raise_for_status()
        if address in loaded:
            assert answer.headers["cache-control"] == "public, max-age=31536000, immutable"
    version = loaded[0].split("/")[1]
    for gone in (
        f"static/{version}/index.html",
        f"static/{version}/none.js",
        "static/0/main.js",
        "static/main.js",
    ):
        assert cross.http.get(f"/{gone}").status_code == 404
    scripts = [
        cross.http.get(f"/static/{version}/{name}").text for name in ("main.js", "link.js", "tiles.js")
    ]
    # No address begins at the root.
    assert [found for text in scripts for found in re.findall(r"""["'`]/\w[^"'`]*""", text)] == []


def test_docs_load_nothing_from_elsewhere(cross):
    page = cross.http.get("/docs")
    assert page.headers["content-type"].startswith("text/html")
    assert "://" not in page.text
    loaded = re.findall(r"""(?:href|src)=["']([^"']+)["']""", page.text)
    assert len(loaded) >= 3
    for address in [*loaded, "/openapi.json"]:
        assert address.startswith("/")
        assert not address.startswith("//")
        assert len(cross.http.get(urljoin("/docs", address)).raise_for_status().content) > 100


OF_SHARES = {"share", "of_others", "shares", "complete", "missing"}
"""What the statuses of shares, and of gateways, say alone."""


def test_openapi_says_what_a_status_holds(cross):
    document, status = cross.http.get("/openapi.json").json(), cross.status()
    schemas = document["components"]["schemas"]

    def compare(value, schema):
        """Whether a value has the schema's names, in its order, down to the leaves."""
        if "anyOf" in schema:
            [schema] = [one for one in schema["anyOf"] if one.get("type") != "null"]
        if "$ref" in schema:
            schema = schemas[schema["$ref"].removeprefix("#/components/schemas/")]
        if "properties" in schema:
            inner = {
                name: of for name, of in schema["properties"].items() if name not in OF_SHARES - set(value)
            }
            assert list(value) == list(inner)
            assert set(schema["required"]) <= set(value)
            for name, part in inner.items():
                compare(value[name], part)
        elif schema["type"] == "object":
            for inner in value.values():
                compare(inner, schema["additionalProperties"])
        else:
            kinds = {"integer": int, "number": float, "string": str, "array": list, "boolean": bool}
            assert value is None or isinstance(value, kinds[schema["type"]])

    for path, method in (("/status", "get"), ("/reset", "post")):
        content = document["paths"][path][method]["responses"]["200"]["content"]
        assert list(content) == ["application/json"]
        assert content["application/json"]["schema"] == {"$ref": "#/components/schemas/Status"}
    assert "store" not in status  # it is only said by a mapper that has one
    store = {"revision": 3, "failing": None, "bytes": 4096}
    assert "robots" not in status["map_info"]  # it is only said of a map that keeps them apart
    status["map_info"]["robots"] = ["robot1"]
    compare({**status, "store": store}, {"$ref": "#/components/schemas/Status"})
    assert status["robots"]


def test_openapi_documents_every_route_and_its_parameters(cross):
    document = cross.http.get("/openapi.json").json()
    assert document["openapi"].startswith("3.")
    assert document["info"]["title"] == "zenoh-ogm mapper"
    paths = document["paths"]
    assert set(paths) == {*ROUTES, TILES, "/snapshots", *QUERIES, *WRITES, *LOG_INS}
    assert {path: set(item) for path, item in paths.items() if set(item) != {"get"}} == {
        **{path: {method} for path, method in {**WRITES, "/check": "post"}.items()},
        **LOG_INS,
    }
    named = {
        path: {parameter["name"] for parameter in item["get"].get("parameters", [])} - VALIDATORS
        for path, item in paths.items()
        if "get" in item
    }
    assert {path: names for path, names in named.items() if names} == {
        "/map.png": {"region", "at", "resolution", "palette", "transparent", "max_size"},
        "/map.pgw": {"region", "at", "resolution", "max_size"},
        "/tiles/{z}/{x}/{y}.png": {"z", "x", "y", "palette", "rev"},
        "/map.json": {"region", "at", "resolution", "values"},
        "/map.pgm": {"region", "at", "resolution", "palette"},
        "/map.yaml": {"region", "at", "resolution"},
        "/map.npz": {"region", "at", "resolution"},
        "/map.tiles": {"since"},
        "/cell": {"x", "y", "resolution"},
        "/distance.png": {"region", "at", "max_distance"},
        "/distance.npz": {"region", "at", "max_distance"},
        "/inflate.png": {"region", "at", "radius"},
        "/inflate.npz": {"region", "at", "radius"},
        "/raycast": {
            *("x", "y", "theta", "angle_min", "angle_increment", "n", "range_max", "unknown"),
        },
    }
    asked = {"/cell": "/cell?x=0&y=0", TILES: TILES.format(z=10, x=-1, y=0)}
    for path in (*ROUTES, TILES):
        operation = paths[path]["get"]
        assert operation["summary"] not in ("", "Handle")
        served = cross.http.get(asked.get(path, path)).headers["content-type"]
        assert list(operation["responses"]["200"]["content"]) == [served.partition(";")[0]]
        for parameter in operation.get("parameters", []):
            in_path = path == TILES and parameter["name"] in ("z", "x", "y")
            in_header = parameter["name"] in VALIDATORS
            assert parameter["in"] == ("path" if in_path else "header" if in_header else "query")
            assert parameter["description"]
            of_cell = path == "/cell" and parameter["name"] != "resolution"
            assert parameter["required"] == (in_path or of_cell)


def test_openapi_documents_what_a_route_may_answer(cross):
    paths = cross.http.get("/openapi.json").json()["paths"]
    documented = {
        path: set(operation["responses"]) for path, item in paths.items() for operation in item.values()
    }
    assert all(answers >= {"200", "400"} for answers in documented.values())
    assert {path for path, answers in documented.items() if "304" in answers} == {*MAPS, TILES, *LAYERS}
    for path in (*MAPS, TILES, *LAYERS):
        needed = {"radius": 1} if path.startswith("/inflate") else {}
        headers = cross.http.get(path.format(z=16, x=0, y=0), params=needed).headers
        sent = {name for name in headers if name == "etag" or name.startswith("ogm-")}
        answers = paths[path]["get"]["responses"]
        assert {name.lower() for name in answers["200"]["headers"]} == sent
        said = {parameter["name"] for parameter in paths[path]["get"]["parameters"]}
        assert said >= VALIDATORS
        assert answers["304"]["headers"] == answers["200"]["headers"]
    for path, query, status in (
        ("/map.png", "palette=blue", 400),
        ("/map.json", "values=", 400),
        ("/map.pgm", "region=1,1,0,0", 400),
        ("/map.png", "max_size=0", 400),
        ("/cell", "x=east&y=0", 400),
    ):
        response = cross.http.get(f"{path}?{query}")
        assert response.status_code == status
        described = paths[path]["get"]["responses"][str(status)]["content"]
        assert list(described) == [response.headers["content-type"]]
        schema = described["application/problem+json"]["schema"]
        assert schema == {"$ref": "#/components/schemas/Problem"}


def test_openapi_describes_values_that_are_taken_and_no_others(cross):
    paths = cross.http.get("/openapi.json").json()["paths"]
    schema = {
        (path, parameter["name"]): parameter["schema"]
        for path, item in paths.items()
        for parameter in item.get("get", {}).get("parameters", [])
    }
    of_a_picture = {(path, name) for path, name in schema if name in ("palette", "transparent", "values")}
    assert len(of_a_picture) == 5
    for path, name in of_a_picture:
        for value in schema[path, name]["enum"]:
            url = path.format(z=16, x=0, y=0)
            assert cross.http.get(url, params={name: value}).status_code == 200
    region = re.compile(schema["/map.png", "region"]["pattern"])
    for text, fits in (
        ("-1,-1,1,1", True),
        ("-1.5,-0.25,+1,1.0", True),
        ("1,2,3", False),
        ("a,0,1,1", False),
    ):
        assert bool(region.fullmatch(text)) == fits
        assert (cross.http.get("/map.png", params={"region": text}).status_code == 200) == fits


@pytest.mark.parametrize(
    "path", ["/nothing", "/map", "/map.gif", "/cell/1", "/reset/x", "/redoc", "/static-offline-docs/x"]
)
def test_an_unknown_route(cross, path):
    assert problem(cross.http.get(path)) == (404, "not-found")


@pytest.mark.parametrize(("method", "path"), [("POST", "/map.png"), ("GET", "/reset"), ("DELETE", "/status")])
def test_a_wrong_method(cross, method, path):
    response = cross.http.request(method, path)
    assert problem(response) == (405, "method-not-allowed")
    assert response.headers["allow"]
    assert cross.status()["revision"] == 3
