"""A session that serves many: a reader that takes nothing holds up nobody; a slow server cuts off nobody."""

import json
import socket
import threading
import time

import pytest
import zenoh

from ogm_client.session import NetworkConfig, _hermetic, open_session

DEADLINE = 30.0
KEY = "ogm/v1/hall/map"


@pytest.mark.parametrize(
    ("config", "wait"),
    [
        (NetworkConfig(listen=("tcp/127.0.0.1:1",), serves=True), 500_000),
        (NetworkConfig(connect=("tcp/127.0.0.1:1",), serves=True), None),
        (NetworkConfig(listen=("tcp/127.0.0.1:1",), connect=("tcp/127.0.0.1:2",), serves=True), None),
        (NetworkConfig(listen=("tcp/127.0.0.1:1",)), None),
    ],
)
def test_only_a_listener_that_serves_is_impatient(config, wait):
    def setting(settings, key):
        return json.loads(settings.get_json(f"transport/link/{key}"))

    tx = "tx/queue/congestion_control/block/wait_before_close"
    ours, zenohs = _hermetic(config), zenoh.Config()
    assert setting(ours, tx) == (wait or setting(zenohs, tx))


@pytest.fixture
def server(endpoint):
    with open_session(NetworkConfig(listen=(endpoint,), serves=True)) as session:
        yield session


@pytest.fixture
def stalled(endpoint):
    """An endpoint that leads to `endpoint`, and brings back nothing once the event is set."""
    port, stall, sockets = int(endpoint.rpartition(":")[2]), threading.Event(), []
    listening = socket.create_server(("127.0.0.1", 0))

    def carry(source, target, may_stall):
        try:
            while data := source.recv(65536):
                if may_stall and stall.is_set():
                    return
                target.sendall(data)
        except OSError:
            pass

    def accept():
        try:
            while True:
                near, _ = listening.accept()
                far = socket.create_connection(("127.0.0.1", port))
                sockets.extend((near, far))
                for arguments in ((near, far, False), (far, near, True)):
                    threading.Thread(target=carry, args=arguments, daemon=True).start()
        except OSError:
            pass

    accepting = threading.Thread(target=accept, daemon=True)
    accepting.start()
    yield f"tcp/127.0.0.1:{listening.getsockname()[1]}", stall
    listening.shutdown(socket.SHUT_RDWR)
    listening.close()
    accepting.join(DEADLINE)
    for each in sockets:
        each.close()


def test_a_reader_that_takes_nothing_is_let_go_before_others_are_held_up(
    server, stalled, endpoint, eventually
):
    address, stall = stalled
    large, sending, sent = bytes(60_000_000), threading.Event(), threading.Event()

    def send(query):
        sending.set()
        with query:
            query.reply(KEY, b"small" if query.parameters else large)
        sent.set()

    def callback(query):
        threading.Thread(target=send, args=(query,), daemon=True).start()

    _held = server.declare_queryable(KEY, zenoh.handlers.Callback(callback, indirect=False))
    with open_session(NetworkConfig(connect=(address,))) as reader:
        eventually(lambda: reader.declare_querier(KEY).matching_status)
        stall.set()
        reader.get(KEY, zenoh.handlers.Callback(lambda _: None, indirect=False), timeout=DEADLINE)
        assert sending.wait(DEADLINE)
        assert sent.wait(4.0)  # Zenoh's own limit is 5 s
        with open_session(NetworkConfig(connect=(endpoint,))) as newcomer:
            eventually(lambda: newcomer.declare_querier(KEY).matching_status.matching)
            (reply,) = newcomer.get(f"{KEY}?small", timeout=DEADLINE)
            assert reply.ok.payload.to_bytes() == b"small"


def test_a_server_that_takes_nothing_for_a_while_cuts_off_no_publisher_that_waits(
    server, endpoint, eventually
):
    received = []

    def slow(sample):
        if not received:
            time.sleep(1.5)  # three times as long as a server itself waits
        received.append(len(sample.payload))

    _held = server.declare_subscriber("ogm/v1/hall/**", zenoh.handlers.Callback(slow, indirect=False))
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        publisher = session.declare_publisher(
            "ogm/v1/hall/robots/r/scan/s", congestion_control=zenoh.CongestionControl.BLOCK
        )
        eventually(lambda: publisher.matching_status.matching)
        for _ in range(400):  # more than all buffers hold
            publisher.put(bytes(50_000))
        eventually(lambda: len(received) == 400)
