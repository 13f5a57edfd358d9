"""Client of a running mapper for programs of asyncio: what `MapClient` does, without holding up the loop."""

import asyncio
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import partial, wraps
from types import TracebackType
from typing import Any, Concatenate, ParamSpec, Self, TypeVar

from ogm_client.errors import ClientError
from ogm_client.follower import MapFollower
from ogm_client.map_change import Change
from ogm_client.map_client import DEFAULT_INTERVAL, DEFAULT_PATIENCE, MapClient
from ogm_client.map_grid import MapGrid
from ogm_client.parameters import Resolution, check_watch
from ogm_client.transport import Version

_THREADS = 8
"""So many questions of a client are asked at a time."""
_P = ParamSpec("_P")
_T = TypeVar("_T")
_C = TypeVar("_C", MapClient, MapFollower)


def _awaited(
    method: Callable[Concatenate[MapClient, _P], _T],
) -> Callable[Concatenate["AsyncMapClient", _P], Awaitable[_T]]:
    """The same method, asked by a thread that the loop does not wait for."""

    @wraps(method)
    async def ask(self: "AsyncMapClient", /, *args: _P.args, **kwargs: _P.kwargs) -> _T:
        return await self._in_thread(partial(method, self._opened, *args, **kwargs))

    return ask


class AsyncMapClient:
    """A connection to the mapper of one map, as an asynchronous context manager.

        async with AsyncMapClient() as mapper:
            grid = await mapper.get_map()
            async for grid in mapper.watch():
                print(grid.revision)

    The methods are those of `MapClient`, with its parameters and its errors. A question that is cancelled is
    still asked to its end, and its answer dropped.
    """

    def __init__(self, address: str | None = None, **options: Any) -> None:  # noqa: ANN401 - as MapClient's
        """Take the address and the options of `MapClient`; it connects when it is entered."""
        self._open = partial(MapClient, address, **options)
        self._client: MapClient | None = None
        self._closed = False
        self._pool = ThreadPoolExecutor(_THREADS, thread_name_prefix="ogm-client")

    get_map = _awaited(MapClient.get_map)
    fetch = _awaited(MapClient.fetch)
    status = _awaited(MapClient.status)
    quality = _awaited(MapClient.quality)
    cell = _awaited(MapClient.cell)
    raycast = _awaited(MapClient.raycast)
    check = _awaited(MapClient.check)
    distance = _awaited(MapClient.distance)
    inflate = _awaited(MapClient.inflate)
    reset = _awaited(MapClient.reset)
    erase = _awaited(MapClient.erase)
    forget = _awaited(MapClient.forget)
    snapshots = _awaited(MapClient.snapshots)
    save_snapshot = _awaited(MapClient.save_snapshot)
    restore_snapshot = _awaited(MapClient.restore_snapshot)
    delete_snapshot = _awaited(MapClient.delete_snapshot)

    @asynccontextmanager
    async def follow(
        self, *, interval: float = DEFAULT_INTERVAL, resolution: Resolution = "fine"
    ) -> AsyncIterator["AsyncMapFollower"]:
        """Follow the map, as `MapClient.follow`: `async with mapper.follow() as follower`."""
        follower = await self._opened_in_thread(
            partial(self._opened.follow, interval=interval, resolution=resolution)
        )
        try:
            yield AsyncMapFollower(follower, self._in_thread)
        finally:
            # Not in the pool: all of its threads may be waiting for answers.
            await asyncio.to_thread(follower.close)

    async def watch(
        self,
        interval: float = DEFAULT_INTERVAL,
        patience: float = DEFAULT_PATIENCE,
        *,
        resolution: Resolution = "fine",
    ) -> AsyncIterator[MapGrid]:
        """Yield the map at once, and again whenever it has changed, as `MapClient.watch`."""
        check_watch(interval, patience)
        async with self.follow(interval=interval, resolution=resolution) as follower:
            seen: Version | None = None
            while True:
                grid = await follower.next_grid(seen, patience)
                seen = Version(grid.epoch, grid.run, grid.revision)
                yield grid
                await asyncio.sleep(interval)

    async def close(self) -> None:
        """Close the connection; closing twice does nothing."""
        if self._client is not None and not self._closed:
            self._closed = True
            # Not in the pool, as above: they get no answer any more.
            await asyncio.to_thread(self._client.close)
        self._pool.shutdown(wait=False)

    async def __aenter__(self) -> Self:
        self._client = await self._opened_in_thread(self._open)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def _opened(self) -> MapClient:
        if self._client is None:
            raise ClientError("the client is not connected: use it inside of `async with`")
        return self._client

    async def _in_thread(self, work: Callable[[], _T]) -> _T:
        return await asyncio.wrap_future(self._submit(work))

    async def _opened_in_thread(self, work: Callable[[], _C]) -> _C:
        """What has to be closed: if nobody waits for it any more, it is once it is there."""
        made = self._submit(work)
        try:
            return await asyncio.wrap_future(made)
        except asyncio.CancelledError:
            made.add_done_callback(_close_made)
            raise

    def _submit(self, work: Callable[[], _T]) -> "Future[_T]":
        try:
            return self._pool.submit(work)
        except RuntimeError as error:  # of a pool that takes no more work
            raise ClientError("the client is closed") from error


class AsyncMapFollower:
    """A `MapFollower` for programs of asyncio: the same, awaited."""

    def __init__(
        self, follower: MapFollower, in_thread: Callable[[Callable[[], Any]], Awaitable[Any]]
    ) -> None:
        """Wait for what a follower tells; `in_thread` does what takes a moment."""
        self._follower = follower
        self._in_thread = in_thread

    @property
    def connected(self) -> bool:
        """Whether the mapper was there when it was last asked, or has spoken since."""
        return self._follower.connected

    async def grid(self) -> MapGrid:
        """The newest map, as `MapFollower.grid`."""
        grid: MapGrid = await self._in_thread(self._follower.grid)
        return grid

    async def wait(
        self, after: tuple[str, str, int] | None = None, timeout: float | None = None
    ) -> Change | None:
        """Wait for a map that is not the one `after`, as `MapFollower.wait`."""
        deadline = math.inf if timeout is None else time.monotonic() + timeout
        with self._listening() as heard:
            while True:
                heard.clear()
                change: Change | None = await self._in_thread(partial(self._follower.wait, after, 0.0))
                left = deadline - time.monotonic()
                if change is not None or left <= 0.0:
                    return change
                await _heard_within(heard, left)

    async def next_grid(self, seen: Version | None, patience: float) -> MapGrid:
        """Wait for a map that is not the one `seen`, as `MapFollower.next_grid`."""
        with self._listening() as heard:
            while True:
                heard.clear()
                left = await self._in_thread(partial(self._follower.left_to_wait, seen, patience))
                if left is None:
                    return await self.grid()
                await _heard_within(heard, left)

    @contextmanager
    def _listening(self) -> Iterator[asyncio.Event]:
        """What is set, on the loop, when there is news."""
        heard, loop = asyncio.Event(), asyncio.get_running_loop()
        end = self._follower.add_listener(lambda: _set_on(loop, heard))
        try:
            yield heard
        finally:
            end()


def _close_made(made: "Future[_C]") -> None:
    if not made.cancelled() and made.exception() is None:
        made.result().close()


def _set_on(loop: asyncio.AbstractEventLoop, heard: asyncio.Event) -> None:
    with suppress(RuntimeError):  # the loop has ended meanwhile
        loop.call_soon_threadsafe(heard.set)


async def _heard_within(heard: asyncio.Event, seconds: float) -> None:
    with suppress(TimeoutError):
        await asyncio.wait_for(heard.wait(), None if seconds == math.inf else seconds)
