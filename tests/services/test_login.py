"""Log-ins: a page gives the token once, and writes by a cookie that no page reads and no other site sends."""

import re

import httpx
import pytest

from ogm_services.mapper.serving.guesses import AT_ONCE, MAX_ADDRESSES, PERIOD, Guesses
from ogm_services.mapper.serving.log_ins import LIFETIME, MAX_LOG_INS, LogIns
from small_proxy import small_proxy

TOKEN = "correct-horse.battery~staple+0/8=="
ALL = ["reset", "erase", "save", "restore", "delete"]
"""Of a mapper that does not keep robots apart."""


@pytest.fixture(scope="module")
def guarded(start_mapper, tmp_path_factory):
    data = tmp_path_factory.mktemp("kept") / "map"
    with start_mapper(map={"resolution": 0.5}, http={"token": TOKEN}, mapper={"data": str(data)}) as mapper:
        mapper.draw_cross()
        yield mapper


@pytest.fixture
def page(guarded):
    """A browser's page, which keeps cookies and says that it is the mapper's own."""
    own = {"Sec-Fetch-Site": "same-origin"}
    with httpx.Client(base_url=guarded.http.base_url, timeout=30.0, headers=own) as client:
        yield client


def log_in(client, token=TOKEN, **options):
    return client.post("/login", json={"token": token}, **options)


def test_a_page_that_has_given_the_token_writes_until_it_logs_out(page):
    asked = {"token_needed": True, "logged_in": False, "may_write": False, "writes": ALL}
    assert page.get("/login").json() == asked
    assert page.post("/reset").status_code == 401
    logged_in = asked | {"logged_in": True, "may_write": True}
    assert log_in(page).raise_for_status().json() == logged_in
    assert page.get("/login").json() == logged_in
    assert page.post("/reset").status_code == 200
    assert page.post("/save?name=a").status_code == 200
    assert page.delete("/snapshots/a").status_code == 200
    kept = dict(page.cookies)
    assert page.post("/logout").raise_for_status().json() == asked
    assert not page.cookies
    assert page.post("/reset").status_code == 401
    page.cookies.update(kept)
    assert page.get("/login").json() == asked
    assert page.post("/reset").status_code == 401


def test_the_cookie_tells_nothing_of_the_token_and_no_script_reads_it(page):
    first, second = (log_in(page).headers["set-cookie"] for _ in range(2))
    port = page.base_url.port
    form = rf"ogm_login_{port}=([\w-]{{43}}); Max-Age=43200; Path=/; HttpOnly; SameSite=Strict"
    values = [re.fullmatch(form, cookie)[1] for cookie in (first, second)]
    assert values[0] != values[1]
    gone = page.post("/logout").headers["set-cookie"]
    assert gone == f"ogm_login_{port}=; Max-Age=0; Path=/; HttpOnly; SameSite=Strict"


@pytest.mark.parametrize("token", ["", "x" * 20, TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "ä"])
def test_a_wrong_token_is_refused_and_gives_no_cookie(page, token):
    response = log_in(page, token)
    assert response.status_code == 401
    assert response.headers["www-authenticate"] == 'Bearer error="invalid_token"'
    assert "set-cookie" not in response.headers
    assert response.json()["detail"] == "POST /login: refused: its token is not the mapper's"


@pytest.mark.parametrize(
    "body",
    [
        b"",
        TOKEN.encode(),
        f"token={TOKEN}".encode(),
        b"[]",
        b"{}",
        b'{"token": 7}',
        b'{"token": "x", "more": 1}',
        f'{{"token": "{TOKEN}"'.encode(),
        b"\xff",
    ],
)
def test_what_is_no_token_in_json_is_refused_and_not_repeated(page, body):
    response = page.post("/login", content=body)
    assert response.status_code == 400
    assert response.json()["detail"] == 'body: a JSON object is needed: {"token": "..."}'
    assert TOKEN not in response.text


def test_a_log_in_has_no_parameters_and_no_long_body(page):
    for method, path in (("GET", "/login"), ("POST", "/login"), ("POST", "/logout")):
        assert page.request(method, f"{path}?a=1").status_code == 400
    assert page.post("/login", content=b" " * 2000).status_code == 413


def test_the_password_of_a_proxy_on_the_way_hinders_no_page_that_is_logged_in(page):
    password = {"Authorization": "Basic b3BlcmF0b3I6c2VjcmV0"}
    assert page.post("/reset", headers=password).status_code == 401
    log_in(page, headers=password).raise_for_status()
    assert page.post("/reset", headers=password).status_code == 200
    assert page.post("/reset", headers={"Authorization": "Bearer x"}).status_code == 401


def test_pages_of_other_origins_neither_log_in_nor_write_by_the_cookie(page):
    foreign = {"Sec-Fetch-Site": "same-site", "Origin": "http://127.0.0.1:1"}
    assert log_in(page, headers=foreign).status_code == 403
    log_in(page).raise_for_status()
    for path in ("/reset", "/logout"):
        assert page.post(path, headers=foreign).status_code == 403
    assert page.get("/login").json()["logged_in"]


@pytest.mark.parametrize("value", ["", "x", "A" * 43, "ä", '"', "="])
def test_a_made_up_cookie_is_none(guarded, value):
    name = f"ogm_login_{guarded.http.base_url.port}"
    headers = {"Cookie": f"a=b; {name}={value}; ;{name}".encode("latin-1")}
    assert guarded.http.post("/reset", headers=headers).status_code == 401
    assert not guarded.http.get("/login", headers=headers).json()["logged_in"]


def test_a_wrong_token_counts_before_a_right_cookie(page):
    log_in(page).raise_for_status()
    assert page.post("/reset", headers={"Authorization": "Bearer x"}).status_code == 401


def test_a_right_token_may_write_without_a_cookie(guarded):
    answer = guarded.http.get("/login", headers={"Authorization": f"Bearer {TOKEN}"})
    assert answer.json() == {"token_needed": True, "logged_in": False, "may_write": True, "writes": ALL}


def test_where_no_token_is_needed_everybody_may_write_what_there_is(start_mapper):
    with start_mapper() as mapper:
        expected = {
            "token_needed": False,
            "logged_in": False,
            "may_write": True,
            "writes": ["reset", "erase"],
        }
        assert mapper.http.get("/login").json() == expected
        response = log_in(mapper.http, "whatever")
        assert (response.status_code, response.json()) == (200, expected)
        assert "set-cookie" not in response.headers


def test_behind_a_proxy_the_cookie_is_for_tls_and_for_the_path(start_mapper):
    http = {"token": TOKEN, "forwarded_allow_ips": ["127.0.0.1"], "hosts": ["map.example"]}
    with start_mapper(http=http) as mapper:
        said = {"X-Forwarded-Proto": "https", "X-Forwarded-Host": "map.example"}
        cookie = log_in(mapper.http, headers=said | {"X-Forwarded-Prefix": "/a/b"}).headers["set-cookie"]
        form = r"ogm_login=[\w-]+; Max-Age=43200; Path=/a/b; HttpOnly; SameSite=Strict; Secure"
        assert re.fullmatch(form, cookie)
        netloc = mapper.http.base_url.netloc.decode()
        with (
            small_proxy(netloc, "/a/b", X_Forwarded_Prefix="/a/b") as address,
            httpx.Client(base_url=f"http://{address}/a/b/") as page,
        ):
            log_in(page).raise_for_status()
            assert page.post("reset").status_code == 200


def test_who_guesses_has_to_wait_by_whichever_way(start_mapper):
    with start_mapper(http={"token": TOKEN, "forwarded_allow_ips": ["127.0.0.1"]}) as mapper:
        guesser, other = ({"X-Forwarded-For": address} for address in ("192.0.2.1", "192.0.2.2"))

        def write(token, who):
            return mapper.http.post("/reset", headers={"Authorization": f"Bearer {token}", **who})

        for _ in range(AT_ONCE // 2):
            assert write("x", guesser).status_code == 401
            assert log_in(mapper.http, "x", headers=guesser).status_code == 401
        epoch = mapper.status()["epoch"]
        for response in (write(TOKEN, guesser), log_in(mapper.http, headers=guesser)):
            assert response.status_code == 429
            assert 0 < int(response.headers["retry-after"]) <= PERIOD
            assert response.json()["type"] == "too-many-guesses"
        assert mapper.status()["epoch"] == epoch
        assert write(TOKEN, other).status_code == 200


def test_guesses_are_forgotten_one_after_the_other():
    now = [100.0]
    guesses = Guesses(lambda: now[0])
    for _ in range(AT_ONCE):
        assert guesses.wait("a") == 0
        guesses.wrong("a")
    assert (guesses.wait("a"), guesses.wait("b")) == (2, 0)
    now[0] += 1.5
    assert guesses.wait("a") == 1
    now[0] += 0.5
    assert guesses.wait("a") == 0
    guesses.wrong("a")
    assert guesses.wait("a") == 2
    now[0] += AT_ONCE * PERIOD
    for _ in range(AT_ONCE):
        assert guesses.wait("a") == 0
        guesses.wrong("a")
    assert guesses.wait("a") == 2


def test_guesses_from_one_network_of_ipv6_are_one_customers():
    guesses = Guesses(lambda: 0.0)
    for number in range(AT_ONCE):
        guesses.wrong(f"2001:db8:0:1::{number:x}")
    assert (guesses.wait("2001:db8:0:1:ffff::1"), guesses.wait("2001:db8:0:2::1")) == (2, 0)


def test_of_many_addresses_the_latest_are_remembered():
    guesses = Guesses(lambda: 0.0)
    for number in range(MAX_ADDRESSES + 50):
        guesses.wrong(f"10.0.{number // 256}.{number % 256}")
    assert len(guesses._remembered_until) == MAX_ADDRESSES


def scope_of(cookies, host=b"a:8000"):
    return {"headers": [(b"host", host), *((b"cookie", cookie) for cookie in cookies)]}


def pair(cookie):
    return cookie.partition(";")[0].encode()


def test_a_log_in_ends_by_itself_and_there_are_not_ever_more():
    now = [0.0]
    log_ins = LogIns(lambda: now[0])
    first, second = (pair(log_ins.begin(scope_of([]))) for _ in range(2))
    assert log_ins.has(scope_of([b"z=1; " + first]))
    now[0] = LIFETIME - 1.0
    latest = [pair(log_ins.begin(scope_of([]))) for _ in range(MAX_LOG_INS - 1)]
    assert [log_ins.has(scope_of([one])) for one in (first, second, *latest)] == [False] + [
        True
    ] * MAX_LOG_INS
    now[0] = float(LIFETIME)
    assert not log_ins.has(scope_of([second]))
    assert log_ins.has(scope_of([latest[0]]))


def test_mappers_on_other_ports_of_a_host_have_other_cookies_and_those_of_two_paths_are_both_looked_at():
    log_ins = LogIns()
    cookie = pair(log_ins.begin(scope_of([])))
    assert cookie.startswith(b"ogm_login_8000=")
    assert not log_ins.has(scope_of([cookie], host=b"a:8001"))
    assert log_ins.has(scope_of([b"ogm_login_8000=other; " + cookie]))
    assert log_ins.has(scope_of([b"ogm_login_8000=other", cookie]))
