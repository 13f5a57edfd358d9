"""Liveliness tokens that tell of topics, kept as they come and go."""

import threading
from collections.abc import Callable

import zenoh

from ogm_core.ros2.topics import Topic

MAX_TOKENS = 20_000
"""So many are kept; no robot has more topics."""


Read = Callable[[str], Topic | None]
"""What a token tells of; None: of nothing of that kind."""


class ZenohTokens:
    """The topics and services that tokens under a key expression tell of, as long as these are alive."""

    def __init__(self, session: zenoh.Session, key: str, read: Read, read_service: Read) -> None:
        self._read, self._read_service = read, read_service
        self._lock = threading.Lock()
        self._alive: dict[str, Topic] = {}
        self._services: dict[str, Topic] = {}
        self._ours: set[str] = set()
        self._subscriber = session.liveliness().declare_subscriber(key, self._changed, history=True)

    def ours(self, token: str) -> None:
        """A token that is our own: it tells of nobody else."""
        with self._lock:
            self._ours.add(token)
            self._alive.pop(token, None)
            self._services.pop(token, None)

    def topics(self) -> list[Topic]:
        """What the tokens tell by now; equal ones once."""
        with self._lock:
            return list(dict.fromkeys(self._alive.values()))

    def server_of(self, name: str) -> Topic | None:
        """What is told of a service by now."""
        with self._lock:
            return next((service for service in self._services.values() if service.name == name), None)

    def close(self) -> None:
        """Look no longer."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _changed(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        put = sample.kind == zenoh.SampleKind.PUT
        for kept, read in ((self._alive, self._read), (self._services, self._read_service)):
            told = read(token) if put else None
            with self._lock:
                if told is None:
                    kept.pop(token, None)
                elif token not in self._ours and len(kept) < MAX_TOKENS:
                    kept[token] = told
