"""Addresses: what an HTTP address must be, and that nobody reads a password in an error."""

import pytest

from ogm_client import BadSetting, CannotConnect, MapClient
from ogm_core.wire.addresses import masked


@pytest.mark.parametrize(
    ("address", "shown"),
    [
        ("http://127.0.0.1:8000", "http://127.0.0.1:8000"),
        ("http://joe:secret@h:80/map", "http://***@h:80/map"),
        ("https://secret@[::1]:80", "https://***@[::1]:80"),
        ("http://joe:sec/r#e?t@h", "http://***@h"),
        ("http://joe:s@ecret@h", "http://***@h"),
        ("tcp/joe:secret@h:1?rel=1#iface=lo", "tcp/***@h:1?rel=1#iface=lo"),
        ("joe:secret@h:1", "***@h:1"),
        ("tcp/a:1, tcp/joe:secret@h:1, tls/b:2", "tcp/a:1, tcp/***@h:1, tls/b:2"),
        (
            "tls/h:1#connect_private_key_base64=secret;iface=lo",
            "tls/h:1#connect_private_key_base64=***;iface=lo",
        ),
    ],
)
def test_an_address_is_shown_without_its_secrets(address, shown):
    assert masked(address) == shown


@pytest.mark.parametrize(
    "url",
    [
        *("http://", "https://", "http://:80", "http:///map", "http://h:99999", "http://h:0", "http://h:x"),
        *("http://h:-1", "http://[::1", "http://a b:1", "http://h:1\n", "http://joe:secret@h:99999"),
        *("http://joe:secret@:1", "http://joe:secret@h:x", "http://h:1?token=secret", "http://h:1#secret"),
    ],
)
def test_a_url_that_leads_nowhere_is_refused_at_once(url):
    with pytest.raises(
        BadSetting, match=r"^address 'http.* a URL looks like http://127\.0\.0\.1:8000$"
    ) as error:
        MapClient(url)
    assert "joe" not in str(error.value)


@pytest.mark.parametrize(
    "url", ["http://127.0.0.1:1", "http://[::1]:1/behind/a/proxy", "https://localhost:1"]
)
def test_one_that_may_lead_somewhere_is_tried(url):
    with MapClient(url) as client, pytest.raises(CannotConnect, match="is `ogm mapper` running there"):
        client.status()


def test_a_user_is_not_named_where_nobody_is():
    with MapClient("http://joe:secret@127.0.0.1:1") as client, pytest.raises(CannotConnect) as error:
        client.status()
    assert "http://***@127.0.0.1:1 " in str(error.value)
    assert "secret" not in str(error.value)


def test_a_token_is_for_http_alone(listener, endpoint):
    for how in ({"address": endpoint}, {"session": listener}, {}):
        with pytest.raises(BadSetting, match=r"^token: it is for HTTP alone \(http:"):
            MapClient(**how, token="secret")
