"""Certificates and keys of a Zenoh configuration that are missing or wrong are named before it is used."""

import json
import subprocess

import pytest

from ogm_client import BadSetting, CannotConnect, CannotListen
from ogm_client.session import NetworkConfig, open_session

OWN = {"listen_certificate": "a.pem", "listen_private_key": "a.key"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with two certificates and their keys, and what is neither."""
    folder = tmp_path_factory.mktemp("certificates")
    for name in "ab":
        new = f"openssl req -x509 -newkey rsa:2048 -nodes -subj /CN={name} -keyout {name}.key -out {name}.pem"
        subprocess.run(new.split(), cwd=folder, check=True, capture_output=True)
    (folder / "junk.pem").write_text("junk")
    return folder


@pytest.fixture
def opening(folder, monkeypatch):
    """`opening(tls, ...)`: open and close a session with these TLS settings, in the certificates' folder."""
    monkeypatch.chdir(folder)

    def open_and_close(tls, endpoint, side="listen"):
        config = {"mode": "peer" if side == "listen" else "client"}
        config |= {"scouting": {"multicast": {"enabled": False}}}
        config |= {"listen": {"endpoints": []}, "connect": {"endpoints": []}}
        config |= {side: {"endpoints": [endpoint]}, "transport": {"link": {"tls": tls}}}
        (folder / "zenoh.json5").write_text(json.dumps(config))
        open_session(NetworkConfig(config_file=folder / "zenoh.json5", connect_timeout=0.1)).close()

    return open_and_close


@pytest.mark.parametrize(
    ("tls", "said"),
    [
        ({"listen_certificate": "no.pem"}, "listen_certificate no.pem: no such file"),
        ({"listen_private_key": "no.key"}, "listen_private_key no.key: no such file"),
        ({"connect_certificate": "no.pem"}, "connect_certificate no.pem: no such file"),
        ({"connect_private_key": "no.key"}, "connect_private_key no.key: no such file"),
        ({"root_ca_certificate": "no.pem"}, "root_ca_certificate no.pem: no such file"),
        ({"root_ca_certificate": "."}, "root_ca_certificate .: is a directory"),
        ({"root_ca_certificate": "junk.pem"}, "root_ca_certificate junk.pem: certificates in PEM form"),
        ({"listen_private_key": "b.key"}, "listen_private_key b.key is not the key of listen_certificate"),
        ({"listen_private_key": "junk.pem"}, "listen_private_key junk.pem is not the key"),
    ],
)
def test_a_file_that_is_missing_or_wrong_is_named(opening, folder, tls, said):
    with pytest.raises(BadSetting) as error:
        opening(OWN | tls, "tls/127.0.0.1:0")
    assert str(error.value).startswith(said)
    assert ("is started, here " + str(folder) in str(error.value)) is ("no." in said or "directory" in said)


def test_what_is_whole_or_not_used_is_taken(opening):
    opening(OWN | {"root_ca_certificate": "a.pem"}, "tls/127.0.0.1:0")
    opening({"listen_certificate": "no.pem"}, "tcp/127.0.0.1:0")


def test_only_an_address_in_use_is_another_mappers(opening, listener, endpoint):
    for tls, where, another in (({}, endpoint, True), ({}, "tls/127.0.0.1:0", False)):
        with pytest.raises(CannotListen) as error:
            opening(tls, where)
        assert ("another mapper" in str(error.value)) is another


def test_who_cannot_connect_is_told_of_dates(opening):
    with pytest.raises(CannotConnect, match="authority has signed, for its name, and not expired"):
        opening({}, "tls/127.0.0.1:1", "connect")
