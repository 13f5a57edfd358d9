"""Liveliness tokens that tell of topics, kept as they come and go."""

import threading
from collections.abc import Callable

import zenoh

from ogm_core.ros2.topics import Topic

MAX_TOKENS = 20_000
"""So many are kept; no robot has more topics."""


class ZenohTokens:
    """The topics that tokens under a key expression tell of, as long as these are alive."""

    def __init__(self, session: zenoh.Session, key: str, read: Callable[[str], Topic | None]) -> None:
        self._read = read
        self._lock = threading.Lock()
        self._alive: dict[str, Topic] = {}
        self._ours: set[str] = set()
        self._subscriber = session.liveliness().declare_subscriber(key, self._changed, history=True)

    def ours(self, token: str) -> None:
        """A token that is our own: it tells of nobody else."""
        with self._lock:
            self._ours.add(token)
            self._alive.pop(token, None)

    def topics(self) -> list[Topic]:
        """What the tokens tell by now; equal ones once."""
        with self._lock:
            return list(dict.fromkeys(self._alive.values()))

    def close(self) -> None:
        """Look no longer."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _changed(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        topic = self._read(token) if sample.kind == zenoh.SampleKind.PUT else None
        with self._lock:
            if topic is None:
                self._alive.pop(token, None)
            elif token not in self._ours and len(self._alive) < MAX_TOKENS:
                self._alive[token] = topic
