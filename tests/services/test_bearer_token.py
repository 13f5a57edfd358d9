"""Bearer token: with one set, whoever writes over HTTP must know it, and nothing tells it."""

import logging
import re
import subprocess
import sys

import pytest

from ogm_client import BadSetting, MapClient, MapperError
from ogm_services.mapper.serving import write_access as write_access_module
from ogm_services.settings.settings import Settings

TOKEN = "correct-horse.battery~staple+0/8=="
RIGHT = f"Bearer {TOKEN}"
WRONG = [
    *(None, "", "Bearer", f"Basic {TOKEN}", TOKEN, f"Bearer{TOKEN}", f"Bearer {TOKEN}x"),
    *(
        f"Bearer {TOKEN[:-1]}",
        f"Bearer {TOKEN.upper()}",
        f"Bearer {TOKEN}, Bearer {TOKEN}",
        "Bearer \xff\xfe",
    ),
]


@pytest.fixture(scope="module")
def guarded(start_mapper):
    with start_mapper(map={"resolution": 0.5}, http={"token": TOKEN}) as mapper:
        mapper.draw_cross()
        yield mapper


def post(mapper, authorization, path="/reset", method="POST"):
    headers = [] if authorization is None else [("Authorization", authorization.encode("latin-1"))]
    return mapper.http.request(method, path, headers=headers)


@pytest.mark.parametrize("authorization", WRONG)
def test_without_the_token_nothing_is_written(guarded, authorization):
    before = guarded.status()["epoch"]
    response = post(guarded, authorization)
    assert response.status_code == 401
    challenge = "Bearer" if authorization is None else 'Bearer error="invalid_token"'
    assert response.headers["www-authenticate"] == challenge
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    body = response.json()
    assert (body["type"], body["status"], body["title"]) == ("unauthorized", 401, "Unauthorized")
    assert "Authorization: Bearer TOKEN" in body["detail"]
    assert "http.token" in body["detail"]
    missing = authorization in (None, "", "Bearer", f"Basic {TOKEN}", TOKEN, f"Bearer{TOKEN}")
    assert ("it carries no token: " in body["detail"]) is missing
    assert ("its token is not the mapper's: " in body["detail"]) is not missing
    assert TOKEN not in response.text
    assert guarded.status()["epoch"] == before


def test_two_tokens_are_none(guarded):
    headers = [("Authorization", RIGHT), ("Authorization", RIGHT)]
    assert guarded.http.post("/reset", headers=headers).status_code == 401


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "MERGE"])
def test_every_method_that_may_write_is_guarded_whatever_the_route(guarded, method):
    for path in ("/reset", "/map.png", "/of-tomorrow"):
        assert post(guarded, None, path, method).status_code == 401
        assert post(guarded, RIGHT, path, method).status_code in (200, 404, 405)


def test_reading_needs_none(guarded):
    for path in ("/status", "/map.json", "/", "/readyz"):
        assert guarded.http.get(path).status_code == 200
        assert guarded.http.head(path).status_code == 200


@pytest.mark.parametrize("scheme", ["Bearer", "bearer", "BEARER", "Bearer "])
def test_with_the_token_the_map_is_emptied(guarded, scheme):
    epoch = guarded.status()["epoch"]
    assert post(guarded, f"{scheme} {TOKEN}").raise_for_status().json()["epoch"] != epoch


def test_a_client_gives_it_with_what_it_writes(guarded):
    url = str(guarded.http.base_url)
    with MapClient(url) as stranger, pytest.raises(MapperError) as refused:
        stranger.reset()
    assert refused.value.status == 401
    epoch = guarded.status()["epoch"]
    with MapClient(url, token=TOKEN) as client:
        client.reset()
    assert guarded.status()["epoch"] != epoch


@pytest.mark.parametrize("token", ["", "a b", "a\r\nHost: x", "ä"])
def test_a_client_takes_no_token_that_is_none_and_repeats_none(token):
    with pytest.raises(BadSetting, match=r"^token: letters, digits and signs without spaces are needed$"):
        MapClient("http://127.0.0.1:1", token=token)


def test_a_page_of_another_origin_may_not_even_with_it(guarded):
    headers = {"Authorization": RIGHT, "Sec-Fetch-Site": "cross-site"}
    assert guarded.http.post("/reset", headers=headers).status_code == 403


def test_it_is_compared_in_the_same_time_whichever_byte_differs(guarded, monkeypatch):
    compared, compare = [], write_access_module.hmac.compare_digest
    monkeypatch.setattr(
        write_access_module.hmac, "compare_digest", lambda *both: compared.append(both) or compare(*both)
    )
    post(guarded, RIGHT), post(guarded, "Bearer x")
    assert compared == [(TOKEN.encode(), TOKEN.encode()), (b"x", TOKEN.encode())]


def test_a_file_may_hold_it_and_nothing_shows_it(start_mapper, tmp_path, caplog):
    file = tmp_path / "token"
    file.write_text(f"{TOKEN}\n")
    caplog.set_level(logging.DEBUG)
    with start_mapper(http={"token_file": str(file)}) as mapper:
        assert post(mapper, f"{RIGHT}x").status_code == 401
        assert post(mapper, RIGHT).status_code == 200
    assert TOKEN not in caplog.text


def test_who_is_refused_stands_in_the_log(start_mapper, caplog):
    """At most once a second and kind, with how many more."""
    with start_mapper(http={"token": TOKEN}) as mapper:
        for _ in range(20):
            assert mapper.http.post("/reset", headers={"Authorization": f"{RIGHT}x"}).status_code == 401
        page, name = {"Sec-Fetch-Site": "cross-site"}, {"Host": "evil.example"}
        assert mapper.http.post("/reset", headers=page).status_code == 403
        assert mapper.http.get("/status", headers=name).status_code == 421
        assert mapper.http.get("/of-tomorrow").status_code == 404
    said = [record for record in caplog.records if "refused over HTTP" in record.message]
    assert {record.levelname for record in said} == {"WARNING"}
    kinds = [re.search(r"\((\d+);", record.message)[1] for record in said]
    assert set(kinds) == {"401", "403", "421"}
    assert kinds.count("401") < 20
    assert "127.0.0.1: POST /reset refused over HTTP, asked for without the mapper's token" in said[0].message
    assert "GET /status refused" in said[-1].message
    assert "Host evil.example" in said[-1].message
    assert TOKEN not in caplog.text


@pytest.mark.parametrize(
    ("host", "token", "warned"),
    [("0.0.0.0", None, 1), ("0.0.0.0", TOKEN, 0), ("127.0.0.1", None, 0), ("localhost", None, 0)],
)
def test_an_open_address_without_one_is_warned_of_once(host, token, warned, caplog):
    from ogm_services.mapper.service import MapperService

    network = {"map_name": "hall", "listen": ["tcp/127.0.0.1:0"]}
    http = {"host": host, "port": 0, "token": token}
    with MapperService(Settings.model_validate({"network": network, "http": http})):
        pass
    said = [record.getMessage() for record in caplog.records if "token" in record.getMessage()]
    assert said == warned * [
        "HTTP on 0.0.0.0 has no token: whoever reaches it may reset the map; set http.token_file"
    ]


def test_the_demo_hands_it_to_its_mapper_in_a_file_of_its_own(tmp_path):
    from ogm_services.commands.demo import _settings_files
    from ogm_services.settings.sources import load_settings

    settings = Settings.model_validate({"network": {"listen": ["tcp/127.0.0.1:0"]}, "http": {"token": TOKEN}})
    mapper, robot = _settings_files(settings, tmp_path)
    read = load_settings(config=mapper, flags={}, environ={})
    assert read.http.write_token() == TOKEN.encode()
    assert mapper.stat().st_mode & 0o777 == 0o600
    assert TOKEN not in robot.read_text()
    assert load_settings(config=robot, flags={}, environ={}).http.write_token() is None


def test_a_wrong_one_is_refused_and_not_shown(tmp_path):
    program = [sys.executable, "-m", "ogm_services", "mapper"]
    for environ in ({"OGM_HTTP__TOKEN": "geheim 12345678 geheim"}, {"OGM_HTTP__TOKEN": ""}):
        done = subprocess.run(program, env=environ, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 2
        assert done.stderr == (
            "ogm: http.token: a token of 16 to 512 letters, digits and - . _ ~ + / is needed "
            "(environment OGM_HTTP__TOKEN)\n"
        )
