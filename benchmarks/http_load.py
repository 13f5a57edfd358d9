"""How much of FastAPI's own speed is left for a map that has not changed: whole, and as "304 Not Modified".

Beside the mapper runs a bare application of one route that returns the same bytes, with the mapper's settings
of uvicorn. Three processes share the machine: wrk with one thread, the mapper and the bare application, which
take turns.
"""

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import get_context

import httpx
import uvicorn
from fastapi import FastAPI, Response

from benchmarks.http_clients import clients, have_wrk, rate_of
from benchmarks.running import STOPPED, map_scans, mapper
from benchmarks.table import Result
from benchmarks.workloads import Workload, lab_exercise, whole_big

CONNECTIONS = 8
ROUNDS, QUICK_ROUNDS = 5, 1
SECONDS, QUICK_SECONDS = 3.0, 1.0
TARGET = 0.85
TIMEOUT = 10.0


def run(quick: bool) -> list[Result]:
    """Measure a small and a large map; `quick`: only the small one, once."""
    if not have_wrk():
        print("left out: HTTP load, wrk is not installed")
        return []
    results = measured(lab_exercise(), ["--preset", "lab"], "200 x 200", quick)
    if not quick:
        results += measured(whole_big(), ["--bounds=-100,-100,100,100"], "4000 x 4000", quick)
    return results


def measured(work: Workload, flags: list[str], cells: str, quick: bool) -> list[Result]:
    """Rates of one map: its picture, and its cells as JSON, which go by gzip."""
    rounds, seconds = (QUICK_ROUNDS, QUICK_SECONDS) if quick else (ROUNDS, SECONDS)
    results = []
    with mapper(*flags) as running:
        map_scans(running, work.scans)
        for path, coding in (("map.png", "identity"), ("map.json", "gzip")):
            ours, takes = f"{running.url}{path}", {"Accept-Encoding": coding}
            body, etag = _as_it_came(ours, takes)
            known = {**takes, "If-None-Match": etag}
            assert httpx.get(ours, headers=known, timeout=TIMEOUT).status_code == 304
            with bare(body) as theirs:
                asked = asked_beside(ours, theirs, etag, f"Accept-Encoding: {coding}")
                rates = interleaved(asked, rounds, seconds)
            said = f"/{path} of {cells} cells, {len(body):,} bytes{' of gzip' * (coding == 'gzip')}"
            results += _compared(f"HTTP: {said}, unchanged; wrk, {CONNECTIONS} connections", rates)
    return results


def _as_it_came(url: str, headers: dict[str, str]) -> tuple[bytes, str]:
    """The body of an answer, packed as it is, and its validator."""
    with httpx.stream("GET", url, headers=headers, timeout=TIMEOUT) as answer:
        body = b"".join(answer.iter_raw())
        assert answer.headers.get("Content-Encoding", "identity") == headers["Accept-Encoding"]
        return body, answer.headers["ETag"]


def _compared(group: str, rates: dict[str, float]) -> list[Result]:
    results = []
    for status, what in (("200", "whole"), ("304", "304 Not Modified")):
        ours_rate, bare_rate = rates[status], rates[f"bare {status}"]
        results += [
            Result(group, f"{what}, answers a second", ours_rate, "/s"),
            Result(group, f"{what}, bare FastAPI", bare_rate, "/s"),
            Result(group, f"{what}, times bare FastAPI", ours_rate / bare_rate, "x", TARGET),
        ]
    return results


def asked_beside(ours: str, theirs: str, etag: str, *headers: str) -> dict[str, tuple[str, tuple[str, ...]]]:
    """URLs and request headers of an answer of ours and of a bare server's: whole, and if it has changed."""
    validator = f"If-None-Match: {etag}"
    return {
        "200": (ours, headers),
        "bare 200": (f"{theirs}map.png", headers),
        "304": (ours, (*headers, validator)),
        "bare 304": (f"{theirs}unchanged.png", (*headers, validator)),
    }


def interleaved(
    asked: dict[str, tuple[str, tuple[str, ...]]], rounds: int, seconds: float
) -> dict[str, float]:
    """The best rate of each URL, with its request headers, in turns of so many seconds."""
    best = dict.fromkeys(asked, 0.0)
    for _ in range(rounds):
        for name, (url, headers) in asked.items():
            with clients(url, CONNECTIONS, seconds, *headers) as load:
                best[name] = max(best[name], rate_of(load, seconds))
    return best


@contextmanager
def bare(body: bytes) -> Iterator[str]:
    """URL of a bare application in a process of its own."""
    context = get_context("spawn")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        process = context.Process(target=_serve, args=(listener, body), name="bare", daemon=True)
        process.start()
        try:
            url = f"http://127.0.0.1:{listener.getsockname()[1]}/"
            assert httpx.get(f"{url}map.png", timeout=TIMEOUT).content == body
            assert httpx.get(f"{url}unchanged.png", timeout=TIMEOUT).status_code == 304
            yield url
        finally:
            process.terminate()
            process.join(STOPPED)
            process.kill()


def _serve(listener: socket.socket, body: bytes) -> None:
    config = uvicorn.Config(
        bare_app(body), log_level="warning", access_log=False, proxy_headers=False, lifespan="off"
    )
    uvicorn.Server(config).run(sockets=[listener])


def bare_app(body: bytes) -> FastAPI:
    """The least that FastAPI can do: one route that returns bytes, and one that says nothing has changed."""
    app = FastAPI()

    @app.get("/map.png")
    async def whole() -> Response:
        return Response(body, media_type="image/png")

    @app.get("/unchanged.png")
    async def unchanged() -> Response:
        return Response(status_code=304)

    return app
