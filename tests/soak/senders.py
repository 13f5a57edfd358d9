"""Senders of the soak, each a process: `python -m tests.soak.senders ENDPOINT URL SECONDS ROBOT:RATE...`.

A robot sends so many scans a second; `stranger:RATE` every kind of bad message and request so many times a
second. At its end a sender prints what it has sent, as JSON.
"""

import json
import sys
import time
from collections import Counter
from random import Random

import zenoh

from ogm_client.session import NetworkConfig, open_session
from ogm_core.types import IDENTITY, PoseStamped
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.messages import encode_pose
from tests.soak.bad_messages import GOOD_BUT_ODD, MESSAGES, REQUESTS, answered
from tests.soak.robots import T0, messages

STRANGER = "stranger"
NAMES_A_TURN = 10
"""Robots that nobody has heard of before, in every turn of the stranger."""
POSES_A_TURN = 1000
"""Poses under a name of its own, 1 ns apart: all of them are kept."""


class Robot:
    """One robot on a session; its messages come at `rate` scans a second, late ones as fast as can be."""

    def __init__(self, session: zenoh.Session, name: str, rate: float) -> None:
        self._session, self._name, self._rate = session, name, rate
        keys = MapKeys("default")
        self._prefix = keys.robots.removesuffix("**") + name
        # A robot that is honest waits for the network, so that what is lost was lost by the mapper.
        self._congestion = (
            zenoh.CongestionControl.DROP if name.startswith("flood") else zenoh.CongestionControl.BLOCK
        )
        self._began = time.monotonic()
        self.sent: Counter[str] = Counter()

    def send_due(self) -> float:
        """Send what is due; return when more is."""
        number = self.sent[self._name]
        if time.monotonic() >= self._began + number / self._rate:
            for key, payload in messages(self._name, number):
                self._session.put(f"{self._prefix}/{key}", payload, congestion_control=self._congestion)
            self.sent[self._name] += 1
        return self._began + (number + 1) / self._rate


class Stranger:
    """Everything that does not belong, kind by kind."""

    def __init__(self, session: zenoh.Session, url: str, rate: float) -> None:
        self._session, self._url, self._rate = session, url, rate
        self._rng = Random(1)
        self._began = time.monotonic()
        self._turns = 0
        self.sent: Counter[str] = Counter()

    def send_due(self) -> float:
        """Send a turn of every kind if one is due; return when the next one is."""
        if time.monotonic() >= self._began + self._turns / self._rate:
            self._turn()
            self._turns += 1
        return self._began + self._turns / self._rate

    def _turn(self) -> None:
        robots = MapKeys("default").robots.removesuffix("/**")
        for n, (kind, make) in enumerate({**MESSAGES, **GOOD_BUT_ODD}.items()):
            key = f"{robots}/mallory-{n // 16}/scan/laser{n % 16}"
            self._session.put(key, make(self._rng))
            self._session.put(f"{robots}/mallory-{n // 16}/pose", make(self._rng))
            self.sent[kind] += 2
        for _ in range(NAMES_A_TURN):
            name = f"nobody-{self._rng.getrandbits(60):x}"
            self._session.put(f"{robots}/{name}/scan/laser", messages("honest-0", 0)[1][1])
            self.sent["a robot nobody has heard of"] += 1
        for n in range(POSES_A_TURN):
            here = PoseStamped(T0 + self._turns * POSES_A_TURN + n, IDENTITY)
            self._session.put(f"{robots}/mallory-poses/pose", encode_pose(here))
        self.sent["a pose 1 ns after the last"] += POSES_A_TURN
        self._session.put(f"{robots}/mallory/oops", b"x")
        self._session.delete(f"{robots}/mallory/pose")
        self.sent["no pose, and no scan"] += 2
        for key in ("ogm/v1/*/reset", "ogm/v1/default/map?format=exe", "ogm/v1/default/cell?x=nan;y=0"):
            list(self._session.get(key, timeout=5.0))
            self.sent["a question that is refused"] += 1
        for kind, request in REQUESTS.items():
            self.sent[f"{kind}: {answered(self._url, request)}"] += 1


def main(endpoint: str, url: str, seconds: str, *robots: str) -> None:
    """Send until the time is over."""
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        senders: list[Robot | Stranger] = []
        for name, _, rate in (robot.partition(":") for robot in robots):
            made = (
                Stranger(session, url, float(rate)) if name == STRANGER else Robot(session, name, float(rate))
            )
            senders.append(made)
        end = time.monotonic() + float(seconds)
        while (now := time.monotonic()) < end:
            due = min(sender.send_due() for sender in senders)
            time.sleep(max(0.0, min(due, end) - now))
        print(json.dumps(sum((sender.sent for sender in senders), Counter())), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
