"""Headers in any combination: no answer is an error of the mapper's own, of another map, or to who may not.

What each header does is other tests' matter; here 1,000 requests made up at random are held to what must be
true of all of them.
"""

import gzip
import random
from collections import Counter

import httpx
import pytest

TOKEN = "correct-horse-battery-staple"
NAME, NAMED, OTHER = "map.example", "https://dash.example", "https://evil.example"
PREFIX = "/maps/hall"
READS = ["/map.json", "/map.yaml", "/map.pgm", "/map.png", "/map.npz", "/map.png?max_size=7"]
READS.append("/tiles/16/0/-1.png")
OTHERS = ["/", "/status", "/openapi.json", "/login", "/tiles.json", "/nowhere", "/cell?x=0&y=0", "/check"]
WRITE = "/save?name=a"
"""Who may is told 503, as this mapper stores no map: so the map stays as it is."""
METHODS = ["GET", "GET", "HEAD", "OPTIONS", "POST", "POST", "DELETE"]
REQUESTS = 1000
SEED = 20


@pytest.fixture(scope="module")
def open_mapper(start_mapper):
    http = {"token": TOKEN, "hosts": [NAME], "forwarded_allow_ips": ["127.0.0.1"], "cors_origins": [NAMED]}
    with start_mapper(map={"resolution": 0.02}, http=http) as mapper:
        mapper.scan([2.0, 1.5, 1.0], pose=[0.0, 0.0, 0.0], at=1, angle_increment=1.5, range_max=2.5)
        mapper.settle(received=1)
        yield mapper


def made_up(rng, tags, cookie):
    """Headers of a request, some of them ill-formed."""
    weight = ["", ";q=0", ";q=0.5", ";q=1", ";q=1.5", "; q=0.001", ";q=x"]
    codings = [f"{name}{rng.choice(weight)}" for name in ("gzip", "identity", "*", "br", "x-gzip", "ä")]
    some_tags = [*tags, *(f"W/{tag}" for tag in tags[:2]), '"x"', "*", "x", '"', "", '"x;gzip"']
    origins = [NAMED, OTHER, f"https://{NAME}", "null", "", "https://", NAMED.upper(), "ä"]
    hosts = [NAME, f"{NAME}:8443", "evil.example", "", "a b", "[::1]", "ä", f"{NAME}, evil.example"]
    likely = {
        "Accept-Encoding": [*codings, ", ".join(rng.sample(codings, 3))],
        "If-None-Match": [*some_tags, ", ".join(rng.sample(some_tags, 2))],
        "If-Match": some_tags,
        "Origin": origins,
        "Sec-Fetch-Site": ["same-origin", "cross-site", "same-site", "none", "", "x"],
        "Access-Control-Request-Method": ["GET", "POST", "DELETE", "x", ""],
        "Access-Control-Request-Headers": ["authorization", "x-y", ""],
        "X-Forwarded-Proto": ["http", "https", "wss", "ftp", "", "https, http", "ä"],
        "X-Forwarded-Host": hosts,
        "X-Forwarded-Prefix": [
            PREFIX,
            "/",
            "",
            "//evil.example",
            "/tiles",
            "/..",
            f"{PREFIX}/",
            "ä",
            "/" * 99,
        ],
        "X-Forwarded-For": ["192.0.2.1", "127.0.0.1", "unknown", "", "[::1]:5, x", "," * 50, "ä"],
        "Forwarded": ["for=192.0.2.1;host=evil.example;proto=https"],
        "Host": hosts,
        "Authorization": ["Basic x", "Bearer", ""],
        "Cookie": [*4 * [cookie], *2 * [f"{cookie}x"], "ogm_login=x", f"a=b; {cookie}", ";;==", "ä"],
    }
    names = [name for name in likely if rng.random() < (0.1 if name == "Host" else 0.25)]
    often = {name: 1 if name == "Host" else rng.choice([1, 1, 2]) for name in names}
    return [(name, rng.choice(likely[name])) for name in names for _ in range(often[name])]


def lines_of(headers, name):
    return [value for key, value in headers if key == name]


def test_whatever_the_headers_say_the_answer_is_right(open_mapper):
    rng = random.Random(SEED)
    login = open_mapper.http.post("/login", json={"token": TOKEN}).raise_for_status()
    cookie = login.headers["set-cookie"].partition(";")[0]
    seen = Counter()
    with httpx.Client(base_url=open_mapper.http.base_url, timeout=30.0) as client:
        client.headers.clear()
        plain = {path: client.get(path).raise_for_status() for path in READS}
        tags = [plain[path].headers["etag"] for path in ("/map.json", "/tiles/16/0/-1.png")]
        tags += [f'{tag[:-1]};gzip"' for tag in tags]
        for _ in range(REQUESTS):
            path, method = rng.choice([*READS, *READS, *OTHERS, *10 * [WRITE]]), rng.choice(METHODS)
            headers = made_up(rng, tags, cookie)
            prefix = PREFIX if PREFIX in lines_of(headers, "X-Forwarded-Prefix")[-1:] else ""
            url = rng.choice(["", prefix]) + path
            encoded = [(name, value.strip().encode("latin-1")) for name, value in headers]
            with client.stream(method, url, headers=encoded) as answer:
                body = b"".join(answer.iter_raw())
            asked = method, url, headers
            seen[answer.status_code] += 1
            if answer.status_code >= 500:
                assert (method, path, answer.status_code) == ("POST", WRITE, 503), asked
                assert may_write(headers, cookie, client.base_url.netloc.decode()), asked
            if method in ("GET", "HEAD") and path in plain:
                look_at_map(asked, answer, body, plain[path], tags)
            look(asked, answer, body)
    assert {200, 204, 304, 400, 401, 403, 404, 405, 412, 421, 503} <= set(seen)


def look_at_map(asked, answer, body, plain, tags):
    """See that it is the map, packed as its validator says, or that it is known, or not the one wanted."""
    method, _, headers = asked
    if answer.status_code == 200:
        packed = answer.headers.get("content-encoding") == "gzip"
        tag = plain.headers["etag"]
        assert answer.headers["etag"] == (f'{tag[:-1]};gzip"' if packed else tag), asked
        assert lines_of(headers, "Accept-Encoding") or not packed, asked
        if method == "GET":
            assert (gzip.decompress(body) if packed else body) == plain.content, asked
    elif answer.status_code == 304:
        assert answer.headers["etag"] in tags, asked
        known = ",".join(lines_of(headers, "If-None-Match"))
        assert "*" in known or answer.headers["etag"] in known, asked
    elif answer.status_code == 412:
        assert lines_of(headers, "If-Match"), asked


def look(asked, answer, body):
    """See that there is a body where there should be, and that no other page is told anything."""
    method, _, headers = asked
    if method == "HEAD" or answer.status_code in (204, 304):
        assert body == b"", asked
    elif answer.status_code != 307:
        assert int(answer.headers["content-length"]) == len(body) > 0, asked
    shared = answer.headers.get("access-control-allow-origin")
    if shared is not None:
        assert shared.lower() == NAMED, asked
        assert shared in lines_of(headers, "Origin"), asked
    assert "access-control-allow-credentials" not in answer.headers
    assert "set-cookie" not in answer.headers


def may_write(headers, cookie, netloc):
    """Whether a request comes from who is logged in, by no page of another origin."""
    pairs = "; ".join(lines_of(headers, "Cookie")).split("; ")
    hosts = [*lines_of(headers, "Host"), *lines_of(headers, "X-Forwarded-Host"), netloc]
    site, origin = lines_of(headers, "Sec-Fetch-Site")[:1], lines_of(headers, "Origin")[:1]
    own = (
        site[0] in ("same-origin", "none") if site else all(one.rpartition("/")[2] in hosts for one in origin)
    )
    return own and cookie in pairs and not lines_of(headers, "Authorization")
