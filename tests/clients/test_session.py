"""Opening sessions: hermetic, quick to say what is wrong, and back by themselves after a break."""

import json
import logging
import math
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace

import pytest
import zenoh

from ogm_client import CannotConnect, CannotListen
from ogm_client.session import NetworkConfig, _hermetic, open_session, resolve_listen
from ogm_core.errors import BadSetting


@pytest.mark.parametrize(
    ("given", "kept"),
    [
        ("tcp/127.0.0.1:0", ("tcp/127.0.0.1:", "")),
        ("tls/localhost:0?rel=1#iface=lo", ("tls/localhost:", "?rel=1#iface=lo")),
        ("ws/127.0.0.1:0", ("ws/127.0.0.1:", "")),
    ],
)
def test_port_0_becomes_a_free_port(given, kept):
    before, after = kept
    resolved = resolve_listen(given)
    assert resolved.startswith(before)
    assert resolved.endswith(after)
    port = int(resolved.removeprefix(before).removesuffix(after))
    with socket.create_server(("127.0.0.1", port)):
        pass


@pytest.mark.parametrize(
    "endpoint", ["tcp/127.0.0.1:7447", "tcp/127.0.0.1:70", "udp/127.0.0.1:0", "nonsense"]
)
def test_other_endpoints_stay_as_they_are(endpoint):
    assert resolve_listen(endpoint) == endpoint


def test_a_host_that_is_not_ours_cannot_be_resolved():
    with pytest.raises(CannotListen, match=r"tcp/192\.0\.2\.1:0"):
        resolve_listen("tcp/192.0.2.1:0")


@pytest.mark.parametrize(
    ("config", "mode"),
    [
        (NetworkConfig(connect=("tcp/127.0.0.1:1",)), "client"),
        (NetworkConfig(listen=("tcp/127.0.0.1:1",)), "peer"),
        (NetworkConfig(listen=("tcp/127.0.0.1:1",), connect=("tcp/127.0.0.1:2",)), "peer"),
        (NetworkConfig(mode="peer", connect=("tcp/127.0.0.1:1",)), "peer"),
    ],
)
def test_a_session_finds_nobody_by_itself(config, mode):
    settings = _hermetic(config)

    def setting(key):
        return json.loads(settings.get_json(key))

    assert setting("mode") == mode
    assert tuple(setting("listen/endpoints")) == config.listen
    assert tuple(setting("connect/endpoints")) == config.connect
    assert setting("scouting/multicast/enabled") is False
    assert setting("scouting/gossip/enabled") is False
    assert setting("transport/shared_memory/enabled") is False
    assert setting("transport/link/tx/lease") == 2000


def test_a_client_and_a_listener_meet(listener, endpoint):
    with open_session(NetworkConfig(connect=(endpoint,))) as client:
        assert [str(zid) for zid in client.info.peers_zid()] == [str(listener.zid())]


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_nothing_to_connect_to_is_said_soon(endpoint, mode):
    start = time.monotonic()
    with pytest.raises(CannotConnect, match=f"{endpoint}.*ogm mapper"):
        open_session(NetworkConfig(mode=mode, connect=(endpoint,), connect_timeout=0.3))
    assert time.monotonic() - start < 20.0


def test_a_silent_port_is_said_soon():
    with socket.create_server(("127.0.0.1", 0)) as server:
        endpoint = f"tcp/127.0.0.1:{server.getsockname()[1]}"
        start = time.monotonic()
        with pytest.raises(CannotConnect, match=endpoint):
            open_session(NetworkConfig(connect=(endpoint,), connect_timeout=0.3))
        assert time.monotonic() - start < 20.0


def test_a_taken_port_is_named(listener, endpoint):
    with pytest.raises(CannotListen, match=f"{endpoint}: Address already in use.*--listen"):
        open_session(NetworkConfig(listen=(endpoint,)))


def test_which_of_listen_and_connect_failed(listener, endpoint):
    free = resolve_listen("tcp/127.0.0.1:0")
    with pytest.raises(CannotConnect, match=free):
        open_session(
            NetworkConfig(listen=(resolve_listen("tcp/127.0.0.1:0"),), connect=(free,), connect_timeout=0.1)
        )
    with pytest.raises(CannotListen, match=endpoint):
        open_session(NetworkConfig(listen=(endpoint,), connect=(endpoint,), connect_timeout=0.1))


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (NetworkConfig(), "at least one endpoint"),
        (NetworkConfig(connect=("localhost:7447",)), "connect localhost:7447: .*tcp/127.0.0.1:7447"),
        (
            NetworkConfig(connect=("http://127.0.0.1:8000",)),
            "http://127.0.0.1:8000: a URL is no Zenoh endpoint",
        ),
        (NetworkConfig(connect=("TCP/127.0.0.1:7447",)), "'TCP' is none of tcp, udp"),
        (NetworkConfig(connect=("tcp/127.0.0.1",)), "tcp/127.0.0.1: a host and a port, 1 to 65535"),
        (NetworkConfig(connect=("tls/[::1]?a=1#iface=lo",)), "a host and a port"),
        (NetworkConfig(connect=("tcp/:7447",)), "a host and a port"),
        (NetworkConfig(connect=("udp/127.0.0.1:0",)), "a host and a port"),
        (NetworkConfig(connect=("ws/127.0.0.1:65536",)), "a host and a port"),
        (NetworkConfig(listen=("7447",)), "listen 7447: "),
        (NetworkConfig(listen=("tcp/127.0.0.1",)), "listen tcp/127.0.0.1: a host and a port, 0 to 65535"),
        (NetworkConfig(listen=("http://127.0.0.1:1",)), "listen http://127.0.0.1:1: a URL is no Zenoh"),
    ],
)
def test_ill_formed_endpoints_are_bad_settings(config, message):
    with pytest.raises(BadSetting, match=message):
        open_session(replace(config, connect_timeout=math.inf))  # at once, however long one would wait


@pytest.fixture
def names(monkeypatch):
    """A name server: `names[host]` is the error number with which a host is not found."""
    errors, known = {}, socket.getaddrinfo

    def getaddrinfo(host, *args, **options):
        if host in errors:
            raise socket.gaierror(errors[host], "no such name here")
        return known(host, *args, **options)

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    return errors


def test_an_unknown_host_is_said_at_once(names):
    names["lost.example"] = socket.EAI_NONAME
    for endpoints in (("tcp/lost.example:7447",), ("tcp/lost.example:1", f"tcp/{'x' * 64}.example:2")):
        with pytest.raises(CannotConnect, match=r"tcp/lost.example:\d+: unknown host 'lost.example'"):
            open_session(NetworkConfig(connect=endpoints, connect_timeout=math.inf))


def test_one_known_host_where_a_mapper_is_is_enough(names, listener, endpoint):
    names["lost.example"] = socket.EAI_NONAME
    with open_session(NetworkConfig(connect=("tcp/lost.example:1", "tcp/127.0.0.1:1", endpoint))) as session:
        assert [str(zid) for zid in session.info.peers_zid()] == [str(listener.zid())]


def test_a_host_that_a_name_server_may_know_later_is_waited_for(names):
    names["later.example"] = socket.EAI_AGAIN
    with pytest.raises(CannotConnect, match="is a mapper running there"):
        open_session(NetworkConfig(connect=("tcp/later.example:1",), connect_timeout=0.1))


def test_a_mapper_or_a_gateway_is_told_to_look_for_a_router(endpoint):
    with pytest.raises(CannotConnect, match=f"{endpoint}: is a Zenoh router running there") as refused:
        open_session(NetworkConfig(connect=(endpoint,), connect_timeout=0.1, serves=True))
    assert "ogm mapper" not in str(refused.value)


def test_who_is_told_to_wait_says_once_for_what(endpoint, caplog, eventually):
    opened = []
    config = NetworkConfig(connect=(endpoint,), connect_timeout=math.inf)
    waiting = threading.Thread(target=lambda: opened.append(open_session(config)))
    with caplog.at_level(logging.WARNING, "ogm_client"):
        waiting.start()
        eventually(lambda: caplog.records)
        with open_session(NetworkConfig(listen=(endpoint,))) as listener:
            waiting.join(30.0)
            with opened[0] as session:
                assert [str(zid) for zid in session.info.peers_zid()] == [str(listener.zid())]
    assert caplog.messages == [f"waiting for a mapper or a Zenoh router at {endpoint}"]


def test_with_a_configuration_file_one_may_wait_too(tmp_path, endpoint, caplog, eventually):
    """In Zenoh's own settings a client tries once."""
    file = tmp_path / "zenoh.json5"
    file.write_text(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}')
    opened = []
    config = NetworkConfig(config_file=file, connect_timeout=math.inf)
    waiting = threading.Thread(target=lambda: opened.append(open_session(config)))
    waiting.start()
    eventually(lambda: caplog.messages == [f"waiting for a mapper or a Zenoh router at {endpoint}"])
    with open_session(NetworkConfig(listen=(endpoint,))):
        waiting.join(30.0)
        opened[0].close()


def test_a_wait_ends(endpoint, caplog):
    with pytest.raises(CannotConnect, match=endpoint):
        open_session(NetworkConfig(connect=(endpoint,), connect_timeout=2.5))
    assert len(caplog.records) == 1
    with pytest.raises(CannotConnect, match=endpoint):
        open_session(NetworkConfig(connect=(endpoint,)))
    assert len(caplog.records) == 1, "who does not wait has nothing to say"


def test_a_taken_port_to_listen_on_is_not_waited_for(listener, endpoint):
    with pytest.raises(CannotListen, match=endpoint):
        open_session(NetworkConfig(listen=(endpoint,), connect=(endpoint,), connect_timeout=math.inf))


def test_a_configuration_file_is_taken_as_it_is(tmp_path, listener, endpoint):
    file = tmp_path / "zenoh.json5"
    file.write_text(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}, id: "c0ffee"}}')
    with open_session(NetworkConfig(config_file=file)) as session:
        assert str(session.zid()) == "c0ffee"
        assert len(session.info.peers_zid()) == 1


def test_given_endpoints_override_the_configuration_file(tmp_path, listener, endpoint):
    file = tmp_path / "zenoh.json5"
    file.write_text('{mode: "peer", connect: {endpoints: ["tcp/127.0.0.1:1"]}, listen: {endpoints: []}}')
    with open_session(NetworkConfig(mode="client", connect=(endpoint,), config_file=file)) as session:
        assert [str(zid) for zid in session.info.peers_zid()] == [str(listener.zid())]
    with pytest.raises(CannotListen, match=endpoint):
        open_session(NetworkConfig(listen=(endpoint,), connect=(endpoint,), config_file=file))


def test_a_failure_of_a_configuration_file_names_its_endpoint(tmp_path, endpoint):
    file = tmp_path / "zenoh.json5"
    file.write_text(f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}')
    with pytest.raises(CannotConnect, match=endpoint):
        open_session(NetworkConfig(config_file=file))


@pytest.mark.parametrize("text", [None, "{mode:", '{"conect": 1}'])
def test_a_bad_configuration_file_is_named(tmp_path, text):
    file = tmp_path / "zenoh.json5"
    if text is not None:
        file.write_text(text)
    with pytest.raises(BadSetting, match=r"zenoh\.json5: ") as caught:
        open_session(NetworkConfig(config_file=file))
    assert "\n" not in str(caught.value)
    assert ".rs:" not in str(caught.value)


def test_a_client_comes_back_after_the_listener_was_away(endpoint, eventually):
    got = []
    config = NetworkConfig(listen=(endpoint,))
    first = open_session(config)
    with open_session(NetworkConfig(connect=(endpoint,))) as client:
        publisher = client.declare_publisher("a/key")
        first.close()
        eventually(lambda: not client.info.peers_zid())
        with open_session(config) as second:
            second.declare_subscriber("a/*", zenoh.handlers.Callback(got.append, indirect=False))
            eventually(lambda: publisher.matching_status.matching)
            publisher.put(b"again")
            eventually(lambda: got)
            assert got[0].payload.to_bytes() == b"again"
    assert len(got) == 1


def test_zenoh_itself_prints_nothing(endpoint):
    program = f"""
from ogm_client.session import NetworkConfig, open_session
from ogm_client import CannotConnect
with open_session(NetworkConfig(listen=("{endpoint}",))):
    with open_session(NetworkConfig(connect=("{endpoint}",))):
        pass
try:
    open_session(NetworkConfig(connect=("{endpoint}",), connect_timeout=0.1))
except CannotConnect:
    print("said so")
"""
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=300, check=True
    )
    assert (done.stdout, done.stderr) == ("said so\n", "")
