"""AsyncMapClient: what MapClient answers, awaited, while the loop goes on."""

import asyncio
import inspect
import threading
import time

import numpy as np
import pytest

from ogm_client import AsyncMapClient, BadParameter, ClientError, MapClient, MapperError, NobodyAnswered
from ogm_client.follower import MapFollower
from ogm_client.zenoh_transport import ZenohTransport

PATIENCE = 30.0
OVER = pytest.mark.parametrize("over", ["http", "zenoh"])


def client_of(mapper, over):
    address = str(mapper.http.base_url) if over == "http" else mapper.endpoint
    return AsyncMapClient(address, map_name="hall", timeout=PATIENCE)


def test_it_has_the_names_of_the_other_one():
    def public(kind):
        return {name for name, _ in inspect.getmembers(kind, callable) if not name.startswith("_")}

    assert public(AsyncMapClient) == public(MapClient)


@OVER
def test_it_answers_what_the_other_one_answers(cross, over):
    async def ask():
        async with client_of(cross, over) as client:
            grid = await client.get_map((-1, -1, 1, 1))
            cell, status = await asyncio.gather(client.cell(0.25, 0.25), client.status())
            with pytest.raises(MapperError, match="wholly outside"):
                await client.get_map(region=(90, 90, 91, 91))
            with pytest.raises(BadParameter):
                await client.fetch("nonsense")
            return grid, cell, status.revision, await client.check([(0.25, 0.25)])

    grid, cell, revision, state = asyncio.run(ask())
    with MapClient(cross.endpoint, map_name="hall", timeout=PATIENCE) as client:
        same = client.get_map((-1, -1, 1, 1))
        assert np.array_equal(grid.log_odds, same.log_odds, equal_nan=True)
        assert (cell, revision, state) == (client.cell(0.25, 0.25), 3, client.check([(0.25, 0.25)]))


def test_the_loop_goes_on_while_an_answer_takes_long(cross, monkeypatch):
    fetch = ZenohTransport.fetch

    async def ask():
        loop, ticked = asyncio.get_running_loop(), asyncio.Event()

        def held(self, name, parameters):
            answer = fetch(self, name, parameters)
            # It ends only if the loop turns meanwhile.
            asyncio.run_coroutine_threadsafe(ticked.wait(), loop).result(PATIENCE)
            return answer

        monkeypatch.setattr(ZenohTransport, "fetch", held)
        async with client_of(cross, "zenoh") as client:
            answer = asyncio.create_task(client.fetch("map.npz"))
            await asyncio.sleep(0)
            ticked.set()
            return await answer

    assert asyncio.run(ask()) == cross.http.get("/map.npz").content


@OVER
def test_it_watches_and_follows(start_mapper, over):
    async def look(mapper):
        async with client_of(mapper, over) as client:
            seen = []
            async for grid in client.watch(interval=0.02):
                seen.append(grid.revision)
                if len(seen) == 1:
                    await asyncio.to_thread(mapper.draw_cross)
                if grid.revision == 3:
                    break
            assert (seen[0], seen[-1]) == (0, 3)
            async with client.follow(interval=0.02) as follower:
                first = await follower.wait()
                assert (first.revision, first.whole, follower.connected) == (3, True, True)
                assert await follower.wait(after=first.version, timeout=0.05) is None
                waiting = asyncio.create_task(follower.wait(after=first.version))
                given_up = asyncio.create_task(follower.wait(after=first.version))
                await asyncio.sleep(0.02)
                given_up.cancel()
                mapper.scan([1.0], at=9, pose=[300.25, 0.25, 0.0], range_max=2.5)
                change = await asyncio.wait_for(waiting, PATIENCE)
                assert (change.revision, change.tiles.tolist()) == (4, [[9, 0]])
                with pytest.raises(asyncio.CancelledError):
                    await given_up
                assert np.array_equal(
                    (await follower.grid()).log_odds, (await client.get_map()).log_odds, equal_nan=True
                )
            with pytest.raises(BadParameter, match="patience"):
                await anext(client.watch(patience=-1.0))

    with start_mapper(map={"resolution": 0.5}) as mapper:
        asyncio.run(look(mapper))


def test_a_mapper_that_has_gone_is_waited_for_as_long_as_patience_says(start_mapper):
    async def look():
        with start_mapper(map={"resolution": 0.5}) as mapper:
            client = client_of(mapper, "http")
            await client.__aenter__()
            maps = client.watch(interval=0.02, patience=0.2)
            assert (await anext(maps)).revision == 0
        began = time.monotonic()
        with pytest.raises((NobodyAnswered, ClientError), match=r"cannot connect|broke off"):
            await anext(maps)
        assert time.monotonic() - began < PATIENCE
        await client.close()

    asyncio.run(look())


def test_a_client_that_is_not_open_says_so(cross):
    async def ask():
        client = client_of(cross, "http")
        with pytest.raises(ClientError, match="inside of `async with`"):
            await client.status()
        async with client:
            await client.status()
        await client.close()
        with pytest.raises(ClientError, match="closed"):
            await client.status()

    asyncio.run(ask())


@OVER
def test_what_is_given_up_while_it_opens_is_closed_once_it_is_there(cross, over, monkeypatch):
    """A client that is given up while it connects, and a follower while it takes the map."""
    begun, go_on, closed = threading.Event(), threading.Event(), threading.Semaphore(0)

    def hold(kind, name):
        method, close = getattr(kind, name), kind.close

        def held(self, *given, **named):
            method(self, *given, **named)
            begun.set()
            assert go_on.wait(PATIENCE)

        def noted(self):
            close(self)
            closed.release()

        monkeypatch.setattr(kind, name, held)
        monkeypatch.setattr(kind, "close", noted)

    async def give_up(opening):
        begun.clear()
        go_on.clear()
        waiting = asyncio.create_task(opening.__aenter__())
        assert await asyncio.to_thread(begun.wait, PATIENCE)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        go_on.set()
        assert await asyncio.to_thread(closed.acquire, timeout=PATIENCE)

    async def ask():
        async with client_of(cross, over) as client:
            hold(MapFollower, "__init__")
            await give_up(client.follow())
        hold(MapClient, "__init__")
        await give_up(client_of(cross, over))

    asyncio.run(ask())


def test_a_client_closes_while_all_of_its_threads_wait_for_answers(cross, monkeypatch):
    asked, closed = threading.Semaphore(0), threading.Event()
    close = ZenohTransport.close

    def wait(self, name, parameters):
        asked.release()
        assert closed.wait(PATIENCE)
        raise ClientError("closed meanwhile")

    def noted(self):
        close(self)
        closed.set()

    monkeypatch.setattr(ZenohTransport, "fetch", wait)
    monkeypatch.setattr(ZenohTransport, "close", noted)

    async def ask():
        async with client_of(cross, "zenoh") as client:
            answers = [asyncio.create_task(client.fetch("status")) for _ in range(20)]
            for _ in range(8):
                assert await asyncio.to_thread(asked.acquire, timeout=PATIENCE)
        ended = await asyncio.gather(*answers, return_exceptions=True)
        assert [str(error) for error in ended] == ["closed meanwhile"] * 20

    asyncio.run(ask())
