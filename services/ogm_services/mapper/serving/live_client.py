"""WebSocket client that watches the map live: it is told what has changed of its view, as often as it likes.

Of a client is kept what it has seen (`Seen`), and no queue: who is slow is waited for, by its own coroutine
alone, and then told the newest at once. So nobody is ever behind by more than an update, or costs others any.
"""

import asyncio
import math
from collections import deque
from collections.abc import Coroutine
from functools import partial
from typing import Final, NoReturn

from starlette.websockets import WebSocket, WebSocketDisconnect

from ogm_core.errors import BadMessage
from ogm_services.mapper.serving.handlers import in_turn
from ogm_services.mapper.serving.live_changes import LiveChanges
from ogm_services.mapper.serving.live_updates import LiveUpdates, Update
from ogm_services.mapper.serving.live_view import Life, Seen, View, decode_view
from ogm_services.replies.answer import Busy
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.turns import Turns

HEARTBEAT: Final = 1.0
"""Between two updates about a map that does not change, s."""
_LATELY: Final = 1.0
"""What it asks for by itself, over HTTP, it may have asked for so much earlier than its view came, s."""


class LiveClient:
    """A client: one coroutine reads what it wants to see, another one writes what has changed of that."""

    def __init__(
        self,
        websocket: WebSocket,
        life: Life,
        updates: LiveUpdates,
        changes: LiveChanges,
        turns: Turns,
        in_flight: InFlight,
    ) -> None:
        """`life`: the map's that it was told first."""
        self._websocket = websocket
        self._first_life = life
        self._updates = updates
        self._changes = changes
        self._turns = turns
        self._in_flight = in_flight
        self._wanted: View | None = None
        """The newest view that has come."""
        self._stirred = asyncio.Event()
        """A view has come, or something has changed."""

    async def serve(self) -> None:
        """Read and write, until it leaves.

        Raises:
            WebSocketDisconnect: it has left.
            BadMessage: it sends something that is no view.
        """
        await _first_end_of(self._read(), self._write())

    async def _read(self) -> NoReturn:
        """Take views."""
        while True:
            message = await self._websocket.receive()
            if message["type"] == "websocket.disconnect":
                raise WebSocketDisconnect(message.get("code", 1005))
            if message.get("bytes") is None:
                raise BadMessage("a text frame: binary ones are needed, with MessagePack")
            self._wanted = decode_view(message["bytes"])
            self._stirred.set()

    async def _write(self) -> NoReturn:
        """Tell what has changed."""
        loop = asyncio.get_running_loop()
        await self._stirred.wait()
        view, seen, lately = None, Seen(self._first_life), _Lately()
        while True:
            self._stirred.clear()
            begun = loop.time()
            assert self._wanted is not None
            if view is not self._wanted:
                before, view = view, self._of_life(self._wanted, seen.life)
                self._wanted = view
                seen = seen.after_move(before, view, lately.revision(seen))
            made = await self._sent(view, seen)
            if made is not None:
                seen = made.seen
            lately.note(begun, seen)
            period = 1 / view.rate
            # Clients of the same rate are told at the same time: what several of them see is encoded once.
            await asyncio.sleep(period * round(begun / period + 1) - loop.time())
            if made is not None and made.moment is not None:
                await self._changes.after(made.moment, self._stirred, max(0.0, HEARTBEAT - period))

    def _of_life(self, view: View, life: Life) -> View:
        """A view, whose `since` is of the map that it was told first, as one of the map that it has now."""
        if view.since is None or life == self._first_life:
            return view
        return view.model_copy(update={"since": 0})

    async def _sent(self, view: View, seen: Seen) -> Update | None:
        """An update that has been sent; None if there is no room for it now."""
        try:
            update = await in_turn(self._turns, partial(self._updates.update, view, seen))
            with self._in_flight.sending(update.body):
                await self._websocket.send_bytes(update.body)
        except Busy:
            return None
        return update


class _Lately:
    """Which revision a client had some _LATELY ago; none, if that was of an older life of the map."""

    def __init__(self) -> None:
        self._marks = deque([(-math.inf, Seen(("", "")))] * 2, maxlen=2)

    def note(self, now: float, seen: Seen) -> None:
        """It has seen so much by now."""
        if now - self._marks[-1][0] >= _LATELY:
            self._marks.append((now, seen))

    def revision(self, seen: Seen) -> int:
        """That revision, of the life of the map that the client has now."""
        _, before = self._marks[0]
        return before.revision if before.life == seen.life else -1


async def _first_end_of(*coroutines: Coroutine[None, None, NoReturn]) -> None:
    """Wait until one of them ends, cancel the others, and raise what it raises."""
    tasks = [asyncio.create_task(coroutine) for coroutine in coroutines]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            await task
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
