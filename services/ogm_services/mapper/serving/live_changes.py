"""Live changes: wakes who waits for the map, or a robot, to change."""

import asyncio
from collections.abc import Callable
from typing import Final

LOOK_PERIOD: Final = 0.01
"""How often it is looked whether anything has changed while anybody waits, s."""


class LiveChanges:
    """One look for all who wait, so that the threads that change something need not know of them.

    All of it belongs to the event loop. While nobody waits nothing is looked at.
    """

    def __init__(self, now: Callable[[], object]) -> None:
        """`now` tells this moment, another one whenever something has changed."""
        self._now = now
        self._waiting: dict[asyncio.Event, object] = {}
        """With the moment that each knows."""
        self._look_is_due = False

    async def after(self, known: object, other: asyncio.Event, timeout: float) -> None:
        """Wait until it is another moment than the one known, `other` is set, or `timeout` s have passed."""
        if other.is_set() or self._now() != known:
            return
        self._waiting[other] = known
        self._look_later()
        try:
            async with asyncio.timeout(timeout):
                await other.wait()
        except TimeoutError:
            pass
        finally:
            del self._waiting[other]

    def _look_later(self) -> None:
        if self._waiting and not self._look_is_due:
            self._look_is_due = True
            asyncio.get_running_loop().call_later(LOOK_PERIOD, self._look)

    def _look(self) -> None:
        self._look_is_due = False
        now = self._now()
        for waiting, known in self._waiting.items():
            if known != now:
                waiting.set()
        self._look_later()
