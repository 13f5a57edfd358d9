"""Memory that a mapper holds for others, by kind: what they make it keep, it counts, and bounds."""

from collections.abc import Callable
from typing import NamedTuple

from ogm_core.units import MEBIBYTE

_PARTS = 16
"""A store with a share of its own gets no more than this part of all memory: several of them must fit."""


class _Store(NamedTuple):
    held: Callable[[], int]
    limit: int | None
    let_go: Callable[[], None] | None


class MemoryUse:
    """Bytes held by kind (the map, the queue, ...), and how many all of them may hold together.

    Those who hold memory add themselves, once, and are asked from any thread: they answer at once.
    """

    def __init__(self, limit: int) -> None:
        """`limit`: bytes of all kinds together."""
        self.limit = limit
        self._stores: dict[str, _Store] = {}

    def add(
        self,
        kind: str,
        held: Callable[[], int],
        limit: int | None = None,
        let_go: Callable[[], None] | None = None,
    ) -> None:
        """Count a kind by what `held` says, bytes; `limit` is its own share, None if it has none.

        `let_go` frees what can be made anew: such a kind is in nobody's way.
        """
        self._stores[kind] = _Store(held, limit, let_go)

    def left(self) -> int:
        """Bytes that may still be held, once the kinds that can have let go of all."""
        return self.limit - sum(store.held() for store in self._stores.values() if store.let_go is None)

    def make_room(self) -> None:
        """Have the kinds that can let go, if all together hold more than they may."""
        if self.total() > self.limit:
            for store in self._stores.values():
                if store.let_go is not None:
                    store.let_go()

    def share(self, wanted: int) -> int:
        """The share of a kind that would like `wanted` bytes: less where there is little memory in all."""
        return max(1, min(wanted, self.limit // _PARTS))

    def held(self) -> dict[str, int]:
        """Bytes by kind, in the order in which they were added."""
        return {kind: store.held() for kind, store in self._stores.items()}

    def limits(self) -> dict[str, int | None]:
        """The share of each kind, bytes; None: as much as the others leave."""
        return {kind: store.limit for kind, store in self._stores.items()}

    def total(self) -> int:
        """Bytes of all kinds together."""
        return sum(self.held().values())

    def in_words(self) -> str:
        """What holds memory, the largest first: "map 812 MiB, queue 12 MiB"."""
        held = sorted(self.held().items(), key=lambda entry: -entry[1])
        return ", ".join(f"{kind} {_size(count)}" for kind, count in held if count) or "nothing is held"


def _size(count: int) -> str:
    return f"{count / MEBIBYTE:.0f} MiB" if count >= MEBIBYTE else f"{count / 1024:.0f} KiB"
