"""Behind reverse proxies: under a path that is stripped or not, and what proxies say that are believed."""

import logging
import re

import httpx
import msgpack
import pytest
from websockets.sync.client import connect

from ogm_core.errors import BadSetting
from ogm_services.mapper.serving.behind_proxies import check_root_path
from small_proxy import small_proxy

PREFIX = "/maps/hall"
NAME = "map.example"
BELIEVED = {"forwarded_allow_ips": ["127.0.0.0/30", "::1"], "hosts": [NAME]}


@pytest.fixture(scope="module")
def under_a_path(start_mapper):
    """A mapper that is told its path."""
    with start_mapper(map={"resolution": 0.5}, http={"root_path": PREFIX}) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture(scope="module")
def believing(start_mapper):
    """A mapper that believes whoever asks from 127.0.0.0 to 127.0.0.3."""
    with start_mapper(map={"resolution": 0.5}, http=BELIEVED) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture(scope="module", params=[True, False], ids=["strips", "does not strip"])
def proxied(request, under_a_path):
    """A client of a proxy before it."""
    netloc = under_a_path.http.base_url.netloc.decode()
    with (
        small_proxy(netloc, PREFIX, strips=request.param) as address,
        httpx.Client(base_url=f"http://{address}", timeout=30.0) as client,
    ):
        yield client


def test_all_routes_are_there_under_the_path_and_nowhere_else(proxied, under_a_path):
    for path in ("/map.png", "/map.json", "/", "/version", "/tiles/16/0/-1.png"):
        expected = under_a_path.http.get(path).raise_for_status()
        for _ in range(2):  # the second time it is ready
            given = proxied.get(f"{PREFIX}{path}")
            assert (given.status_code, given.content) == (200, expected.content)
    assert proxied.get(f"{PREFIX}/nowhere").json()["type"] == "not-found"
    assert proxied.get("/map.png").status_code == 404


def test_tiles_are_where_the_description_says(proxied):
    (template,) = proxied.get(f"{PREFIX}/tiles.json").json()["tiles"]
    netloc = proxied.base_url.netloc.decode()
    assert template == f"http://{netloc}{PREFIX}/tiles/{{z}}/{{x}}/{{y}}.png"
    tile = proxied.get(template.format(z=16, x=0, y=-1)).raise_for_status()
    assert tile.content.startswith(b"\x89PNG")


def test_long_questions_and_websockets_come_through_too(proxied, under_a_path):
    points = {"points": [[1.75, 0.25]] * 2000}
    answer = proxied.post(f"{PREFIX}/check", json=points).raise_for_status()
    assert answer.json()["states"] == ["free"] * 2000
    netloc = under_a_path.http.base_url.netloc.decode()
    for path in ("/ws", f"{PREFIX}/ws"):
        with connect(f"ws://{netloc}{path}", proxy=None) as socket:
            assert msgpack.unpackb(socket.recv(timeout=30.0))["type"] == "hello"


def test_the_documentation_and_all_that_it_loads_is_there(proxied):
    page = proxied.get(f"{PREFIX}/docs").raise_for_status().text
    loaded = set(re.findall(r"""(?:src|href)="([^"]+)"|url: '([^']+)'""", page))
    paths = {one or other for one, other in loaded}
    assert f"{PREFIX}/openapi.json" in paths
    assert len(paths) >= 4
    for path in paths:
        assert path.startswith(f"{PREFIX}/")
        assert proxied.get(path).status_code == 200
    assert proxied.get(f"{PREFIX}/openapi.json").json()["servers"] == [{"url": PREFIX}]


def test_the_path_alone_leads_to_the_page(under_a_path):
    redirect = under_a_path.http.get(f"{PREFIX}?x=1")
    assert (redirect.status_code, redirect.headers["location"]) == (307, f"{PREFIX}/?x=1")
    slash = under_a_path.http.get(f"{PREFIX}/status/")
    assert slash.headers["location"].endswith(f"{PREFIX}/status")


def test_what_only_begins_like_the_path_is_not_under_it(under_a_path):
    assert under_a_path.http.get(f"{PREFIX}way/status").status_code == 404


def test_requests_are_counted_by_route_under_a_path_too(under_a_path):
    under_a_path.http.get(f"{PREFIX}/cell?x=0&y=0").raise_for_status()
    text = under_a_path.http.get("/metrics").text
    (line,) = re.findall(r'^ogm_http_requests_total\{(?=.*route="/cell").*$', text, re.M)
    assert line.endswith(" 1.0")


@pytest.mark.parametrize("root_path", ["/tiles", "/docs", "/snapshots", "/tiles/{z}"])
def test_a_path_with_routes_of_its_own_is_none(under_a_path, root_path):
    routes = under_a_path.service._http_thread._server.config.app.routes
    with pytest.raises(BadSetting, match=rf"^http.root_path {re.escape(root_path)}: the mapper serves /"):
        check_root_path(root_path, routes, "http.root_path")
    check_root_path("/tile", routes, "http.root_path")


def forwarded(proto="https", host=NAME, prefix=PREFIX, **others):
    said = {"X-Forwarded-Proto": proto, "X-Forwarded-Host": host, "X-Forwarded-Prefix": prefix, **others}
    return {name: value for name, value in said.items() if value is not None}


def base(mapper, headers, path="/tiles.json"):
    response = mapper.http.get(path, headers=headers)
    (template,) = response.raise_for_status().json()["tiles"]
    return template.removesuffix("tiles/{z}/{x}/{y}.png")


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        ({}, f"https://{NAME}{PREFIX}/"),
        ({"proto": "http"}, f"http://{NAME}{PREFIX}/"),
        ({"proto": "WSS"}, f"https://{NAME}{PREFIX}/"),
        ({"proto": "http, https"}, f"https://{NAME}{PREFIX}/"),
        ({"host": f"{NAME}:8443"}, f"https://{NAME}:8443{PREFIX}/"),
        ({"host": f"evil.example, {NAME}"}, f"https://{NAME}{PREFIX}/"),
        ({"prefix": "/maps/"}, f"https://{NAME}/maps/"),
        ({"prefix": "/"}, f"https://{NAME}/"),
        ({"prefix": None}, f"https://{NAME}/"),
    ],
)
def test_what_a_proxy_says_is_believed(believing, said, expected):
    assert base(believing, forwarded(**said)) == expected


def test_a_path_is_found_with_the_prefix_that_a_proxy_says_and_without(believing):
    assert base(believing, forwarded(), f"{PREFIX}/tiles.json") == f"https://{NAME}{PREFIX}/"
    assert believing.http.get(f"{PREFIX}/tiles.json").status_code == 404


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ({"proto": "ftp"}, "X-Forwarded-Proto 'ftp'"),
        ({"proto": ""}, "X-Forwarded-Proto ''"),
        ({"prefix": "//evil.example"}, "X-Forwarded-Prefix"),
        ({"prefix": "maps"}, "X-Forwarded-Prefix"),
        ({"prefix": "/a/../b"}, "X-Forwarded-Prefix"),
        ({"prefix": '/"><script>'}, "X-Forwarded-Prefix"),
        ({"prefix": "/tiles"}, "X-Forwarded-Prefix /tiles: the mapper serves /tiles"),
        ({"host": "a b"}, "Host 'a b'"),
        ({"host": ""}, "Host ''"),
    ],
)
def test_what_is_ill_formed_is_refused(believing, said, told):
    for method, path in (("GET", "/tiles.json"), ("GET", "/map.png"), ("POST", "/reset")):
        response = believing.http.request(method, path, headers=forwarded(**said))
        assert response.status_code == 400
        assert response.json()["detail"].startswith(told)


def test_a_host_that_a_proxy_says_must_be_the_mappers_too(believing):
    response = believing.http.get("/status", headers=forwarded(host="evil.example"))
    assert (response.status_code, response.json()["type"]) == (421, "misdirected")


def test_a_page_whose_name_leads_here_does_not_say_that_it_has_another(believing):
    """DNS rebinding: to the browser it is of the same origin, so that it may send any header."""
    headers = forwarded(host="localhost") | {"Host": "evil.example"}
    for method in ("GET", "POST"):
        assert believing.http.request(method, "/status", headers=headers).status_code == 421


def test_pages_of_the_proxys_name_may_write_and_others_may_not(believing):
    epoch = believing.status()["epoch"]
    foreign = {"Origin": f"http://{believing.http.base_url.netloc.decode()}"}
    assert believing.http.post("/reset", headers=forwarded() | foreign).status_code == 403
    assert believing.status()["epoch"] == epoch
    own = {"Origin": f"https://{NAME}"}
    assert believing.http.post("/reset", headers=forwarded() | own).status_code == 200
    assert believing.status()["epoch"] != epoch


def test_whoever_is_no_such_proxy_is_not_believed(start_mapper):
    http = {"forwarded_allow_ips": ["127.0.0.2", "10.0.0.0/8"], "hosts": [NAME]}
    with start_mapper(http=http) as mapper:
        own = f"http://{mapper.http.base_url.netloc.decode()}/"
        assert base(mapper, forwarded()) == own
        assert base(mapper, forwarded(proto="ftp", host="evil.example", prefix="/tiles")) == own
        assert mapper.http.get(f"{PREFIX}/status", headers=forwarded()).status_code == 404


@pytest.mark.parametrize(
    ("said", "who"),
    [
        ("192.0.2.7", "192.0.2.7"),
        ("192.0.2.7, 127.0.0.2", "192.0.2.7"),
        ("198.51.100.1, 192.0.2.7, 127.0.0.2, 127.0.0.1", "192.0.2.7"),
        ("192.0.2.7:5678", "192.0.2.7"),
        ("[2001:db8::7]:5678", "2001:db8::7"),
        ("2001:db8::7", "2001:db8::7"),
        ("fe80::7%eth0", "fe80::7"),
        (f"fe80::7%{'x' * 5000}", "fe80::7"),
        ("192.0.2.7, unknown", "127.0.0.1"),
        ("", "127.0.0.1"),
    ],
)
def test_the_log_names_who_has_asked_the_proxy(believing, caplog, said, who):
    caplog.set_level(logging.INFO)
    believing.http.post("/reset", headers={"X-Forwarded-For": said}).raise_for_status()
    assert [text for text in caplog.messages if "has reset the map" in text][-1].startswith(
        f"{who} over HTTP has reset the map"
    )
