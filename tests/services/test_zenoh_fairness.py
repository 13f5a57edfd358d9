"""The status over Zenoh while forty clients ask for figures and maps at once, and one takes nothing."""

import threading
from contextlib import ExitStack

import pytest
import zenoh

from ogm_client.session import NetworkConfig, open_session
from ogm_services.mapper.serving.answers import Answers

CLIENTS = 40
ASKED = 200
DEADLINE = 1.0
LARGE = ("quality", "map?format=json", "quality", "map?format=npz")
FIGURES = 0.8
"""How long figures take, as of a map that is much larger, s."""


@pytest.fixture
def slow_figures(monkeypatch):
    """Figures take FIGURES; of a mapper that starts later."""
    quality = Answers.quality
    monkeypatch.setattr(Answers, "quality", lambda *given: threading.Event().wait(FIGURES) or quality(*given))


@pytest.fixture
def joined(mapper):
    """`joined()` opens one more session with the mapper."""
    with ExitStack() as opened:
        yield lambda: opened.enter_context(open_session(NetworkConfig(connect=(mapper.endpoint,))))


def test_the_status_is_answered_within_a_second_while_forty_ask_and_one_does_not_read(
    slow_figures, mapper, joined, eventually
):
    for k in range(20):  # 300 x 300 m: JSON of about 1 MB
        mapper.scan([7.0] * 90, angle_increment=0.0698, pose=[15.0 * k, 15.0 * k, 0.0], at=k, seq=k)
    mapper.settle(received=20)
    root, stop, go_on = mapper.keys.root, threading.Event(), threading.Event()
    answered, held = [0] * CLIENTS, []

    def ask(session, k):
        while not stop.is_set():
            answered[k] += sum(reply.ok is not None for reply in session.get(f"{root}/{LARGE[k % 4]}"))

    def take_nothing(reply):
        held.append(reply)
        go_on.wait(60.0)  # on the thread that reads the link

    frozen, sessions, probe = joined(), [joined() for _ in range(CLIENTS)], joined()
    eventually(lambda: [*probe.get(f"{root}/status")])
    threads = [threading.Thread(target=ask, args=each) for each in zip(sessions, range(CLIENTS), strict=True)]
    try:
        for thread in threads:
            thread.start()
        eventually(lambda: all(answered))
        for _ in range(20):
            handler = zenoh.handlers.Callback(take_nothing, indirect=False)
            frozen.get(f"{root}/map?format=json", handler, timeout=60.0)
        eventually(lambda: held)
        in_time = sum(
            any(reply.ok is not None for reply in probe.get(f"{root}/status", timeout=DEADLINE))
            for _ in range(ASKED)
        )
        assert len(held) == 1
    finally:
        stop.set()
        go_on.set()
        for thread in threads:
            thread.join()
    assert in_time >= 0.99 * ASKED
