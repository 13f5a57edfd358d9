"""What tiles cost: overviews that are kept up to date while a map grows, and a tile that has not changed.

Overviews are measured in this process by CPU time, on workload `big` with ten updates a second of integration
at full load: each brings all levels of all tiles up to date that scans have written since the one before.
So are the messages that tell followers of these tiles. Nothing of this is done while nobody looks. Answers
over HTTP are measured as those of whole maps are (see benchmarks.http_load).
"""

import time
from collections.abc import Callable, Iterator
from typing import cast

import httpx
import numpy as np

from benchmarks.http_clients import have_wrk
from benchmarks.http_load import CONNECTIONS, TIMEOUT, asked_beside, bare, interleaved
from benchmarks.running import map_scans, mapper
from benchmarks.table import Result
from benchmarks.workloads import Workload, first_scans, mapped, settings_of, whole_big
from ogm_core.grid import OccupancyGrid
from ogm_core.pictures.tile_png import tile_png, tile_stream
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.tiles.overviews import OVERVIEW_BYTES
from ogm_core.tiles.pyramid import Square, TilePyramid, revision_of
from ogm_core.tiles.view import TileView
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import encode_update

ROUNDS, QUICK_ROUNDS = 5, 1
SECONDS, QUICK_SECONDS = 3.0, 1.0
QUICK_SCANS = 300
PERIOD = 0.1
"""Time of integration between two updates, s."""
UPKEEP_TARGET, TOLD_TARGET, WARM_TARGET = 15.0, 15.0, 0.8
ALL = [Square(10, x, y) for x in (-1, 0) for y in (-1, 0)]
"""Tiles that show all of the workload's map."""
WARM = Square(13, 0, -1)


def run(quick: bool) -> list[Result]:
    """Measure on workload `big`; `quick`: on its first scans, once."""
    work = first_scans(whole_big(), QUICK_SCANS) if quick else whole_big()
    rounds = QUICK_ROUNDS if quick else ROUNDS
    return [*upkeep(work, rounds), *told(work, rounds), *pictures(work, rounds), *warm(work, quick)]


def upkeep(work: Workload, rounds: int) -> list[Result]:
    """How much overviews cost beside integration, at PERIOD."""
    mapped(first_scans(work, 1))
    spent = np.min([_mapped_and_looked_at(work) for _ in range(rounds)], axis=0)
    integration, copies, overviews, made = spent.tolist()
    group = f"overviews of big, brought up to date {1 / PERIOD:.0f} times a second of integration: CPU time"
    share, of_copies = 100 * overviews / integration, 100 * (overviews + copies) / integration
    return [
        Result(group, "share of integration", share, "%", UPKEEP_TARGET, at_least=False),
        Result(group, "the same with the copies that readers get", of_copies, "%"),
        Result(group, "for each tile of 64 x 64 cells that was written", 1e6 * overviews / made, "us"),
        Result(group, "memory for each such tile, once somebody looks", OVERVIEW_BYTES, "B"),
    ]


def _mapped_and_looked_at(work: Workload) -> tuple[float, float, float, int]:
    """CPU time of integration, of copies and of overviews, s, and how many tiles were made anew."""
    mapping, pyramid = _Mapping(work), TilePyramid()
    overviews, made, looked = 0.0, 0, 0
    for snapshot in mapping:
        begin = time.thread_time()
        for square in ALL:
            pyramid.pixels(_view(snapshot), snapshot.model, square)
        overviews += time.thread_time() - begin
        revisions = _view(snapshot).tiles.revisions(slice(None), slice(None))
        made += int(np.count_nonzero(revisions > looked))
        looked = snapshot.revision
    return mapping.integration, mapping.copies, overviews, made


def told(work: Workload, rounds: int) -> list[Result]:
    """How much telling followers costs beside integration, at PERIOD, however many they are."""
    mapped(first_scans(work, 1))
    spent = np.min([_mapped_and_told(work) for _ in range(rounds)], axis=0)
    integration, copies, telling, tiles, size = spent.tolist()
    group = f"followers of big, told {1 / PERIOD:.0f} times a second of integration: CPU time of the mapper"
    return [
        Result(group, "share of integration", 100 * telling / integration, "%", TOLD_TARGET, at_least=False),
        Result(
            group, "the same with the copies that readers get", 100 * (telling + copies) / integration, "%"
        ),
        Result(group, "for each tile of 64 x 64 cells that was written", 1e6 * telling / tiles, "us"),
        Result(group, "bytes for each such tile", size / tiles, "B"),
    ]


def _mapped_and_told(work: Workload) -> tuple[float, float, float, int, int]:
    """CPU time of integration, of copies and of messages, s; how many tiles were told, in how many bytes."""
    mapping = _Mapping(work)
    telling, tiles, size, seen = 0.0, 0, 0, 0
    for snapshot in mapping:
        begin = time.thread_time()
        changed = ChangedTiles.since(_view(snapshot).tiles, seen)
        messages = [encode_update(update) for update in updates_of(snapshot, changed, seen)]
        telling += time.thread_time() - begin
        tiles, size = tiles + len(changed), size + sum(map(len, messages))
        seen = snapshot.revision
    return mapping.integration, mapping.copies, telling, tiles, size


class _Mapping:
    """A workload that is integrated, and the CPU time of it; iterating gives the map at each PERIOD of it."""

    def __init__(self, work: Workload) -> None:
        self._work = work
        self.integration = self.copies = 0.0
        """Time of integration, and of the copies that are given, s."""

    def __iter__(self) -> Iterator[MapSnapshot]:
        grid, since = OccupancyGrid(settings_of(self._work)), 0.0
        for n, (scan, pose, _) in enumerate(self._work.scans):
            begin = time.thread_time()
            grid.integrate(scan, pose)
            took = time.thread_time() - begin
            self.integration, since = self.integration + took, since + took
            if since < PERIOD and n + 1 < len(self._work.scans):
                continue
            begin = time.thread_time()
            snapshot = grid.snapshot()
            self.copies += time.thread_time() - begin
            yield snapshot
            since = 0.0


def pictures(work: Workload, rounds: int) -> list[Result]:
    """How long a tile takes from cells to PNG, and to tell whether it has changed."""
    snapshot, pyramid = mapped(work).snapshot(), TilePyramid()
    view, model = _view(snapshot), snapshot.model
    group = "a tile of big: CPU time"
    results = []
    for z in (16, 15, 13, 10):
        square = Square(z, 0, -1)
        pyramid.pixels(view, model, square)
        ms = 1e3 * _best(lambda s=square: tile_stream(pyramid.pixels(view, model, s)), rounds)  # type: ignore[misc]
        results.append(Result(group, f"z = {z}, its overviews at hand, from cells to a stream", ms, "ms"))
    stream = tile_stream(pyramid.pixels(view, model, WARM))
    us = 1e6 * _best(lambda: tile_png(stream, "ros"), rounds)
    results.append(Result(group, "a PNG of a stream that is kept", us, "us"))
    us = 1e6 * _best(lambda: revision_of(view.tiles, model, WARM), rounds)
    results.append(Result(group, "whether it has changed", us, "us"))
    return results


def _best(work: Callable[[], object], rounds: int) -> float:
    """The least CPU time of doing it once, s."""
    best = np.inf
    for _ in range(20 * rounds):
        begin = time.thread_time()
        work()
        best = min(best, time.thread_time() - begin)
    return float(best)


def warm(work: Workload, quick: bool) -> list[Result]:
    """A tile of a map that does not change, beside a bare FastAPI that returns the same bytes."""
    if not have_wrk():
        print("left out: tiles over HTTP, wrk is not installed")
        return []
    with mapper() as running:
        map_scans(running, work.scans)
        ours = f"{running.url}tiles/{WARM.z}/{WARM.x}/{WARM.y}.png"
        answer = httpx.get(ours, timeout=TIMEOUT)
        with bare(answer.content) as theirs:
            rounds, seconds = (QUICK_ROUNDS, QUICK_SECONDS) if quick else (ROUNDS, SECONDS)
            asked = asked_beside(ours, theirs, answer.headers["ETag"])
            rates = interleaved(asked, rounds, seconds)
    group = f"HTTP: a tile of big, {len(answer.content):,} bytes, unchanged; wrk, {CONNECTIONS} connections"
    results = []
    for status, what in (("200", "whole"), ("304", "304 Not Modified")):
        times = rates[status] / rates[f"bare {status}"]
        results += [
            Result(group, f"{what}, answers a second", rates[status], "/s"),
            Result(group, f"{what}, times bare FastAPI", times, "x", WARM_TARGET),
        ]
    return results


def _view(snapshot: MapSnapshot) -> TileView:
    return cast(TileView, snapshot.stored)
