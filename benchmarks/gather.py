"""Gathering a map from four shares through a router: all of it, what one scan has changed, and nothing new.

The shares are `ogm mapper --share` processes with a map of 20 MB of cells, about; a gateway's gathering is
measured in this process, from the questions to the snapshot. Wall clock: it waits for other processes.
"""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import zenoh

from benchmarks.running import line_after, ogm, router
from benchmarks.table import Result
from benchmarks.workloads import big, settings_of
from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.grid_settings import GridSettings
from ogm_core.shares import Cuts
from ogm_core.types import PlacedScan
from ogm_core.wire.keys import MapKeys
from ogm_services.mapper.shares.gathered_map import GatheredMap
from ogm_services.mapper.shares.gathering import Gathering
from ogm_services.mapper.shares.layout import ShareLayout

SCANS, QUICK_SCANS = 1000, 100
ROUNDS, QUICK_ROUNDS = 15, 5
GROUP = "gathering from 4 shares"
CUTS = Cuts((0.0,), (0.0,))
REACH = 10.0
WHOLE_MS, NOTHING_MS = 80.0, 2.0
"""Targets: p50 of a map of 20 MB, and of nothing new."""
SETTLED = 120.0


def run(quick: bool) -> list[Result]:
    """Measure; `quick`: a smaller map, and fewer rounds."""
    work = big(QUICK_SCANS if quick else SCANS)
    settings = GridSettings(resolution=work.resolution, alpha=work.alpha, reach=REACH)
    assert settings_of(work).lattice == settings.lattice
    rounds = QUICK_ROUNDS if quick else ROUNDS
    with (
        shares(settings) as (endpoint, session),
        RobotPublisher("robot1", address=endpoint, reliable=True) as robot,
    ):
        fresh = _fresh(session, settings)
        for placed in work.scans:
            _put(robot, placed)
        _settle(fresh, len(work.scans))
        size = fresh.newest.state.copies.nbytes / 1e6
        whole = [_timed(_fresh(session, settings).gather) for _ in range(rounds)]
        changed = []
        for placed in work.scans[:rounds]:
            _put(robot, placed)
            time.sleep(0.05)  # until they have it
            changed.append(_timed(fresh.gather))
        nothing = [_timed(fresh.gather) for _ in range(10 * rounds)]
    return [
        Result(GROUP, "cells", size, "MB"),
        *_p50("all of it, as for 20 MB", whole, WHOLE_MS, 20.0 / size),
        *_p50("after one scan", changed),
        *_p50("nothing new", nothing, NOTHING_MS),
    ]


@contextmanager
def shares(settings: GridSettings) -> Iterator[tuple[str, zenoh.Session]]:
    """Four mappers that are ready, where they are reached, and a session with them, by a router."""
    flags = ["--http-port", "0", "--log-level", "warning"]
    flags += [f"--resolution={settings.resolution}", f"--alpha={settings.alpha}", f"--reach={settings.reach}"]
    flags += ["--cuts-x=0", "--cuts-y=0"]
    with ExitStack() as opening:
        endpoint = opening.enter_context(router())
        flags += ["--connect", endpoint]
        started = [opening.enter_context(ogm("mapper", f"--share={k}", *flags)) for k in range(CUTS.count)]
        for process in started:
            line_after(process, "status ")
        yield endpoint, opening.enter_context(open_session(NetworkConfig(connect=(endpoint,))))


def _fresh(session: zenoh.Session, settings: GridSettings) -> Gathering:
    """A gathering that holds nothing."""
    gathered = GatheredMap(settings, ShareLayout.of(CUTS, settings.lattice), "bench")
    return Gathering(session, MapKeys("default"), gathered, timeout=10.0)


def _put(robot: RobotPublisher, placed: PlacedScan) -> None:
    scan = placed.scan
    robot.publish_scan(
        scan.ranges,
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        pose=placed.pose,
    )


def _settle(gathering: Gathering, scans: int) -> None:
    """Wait until every share has so many scans."""
    deadline = time.monotonic() + SETTLED
    while any(part is None or part.revision < scans for part in gathering.gather().state.parts):
        if time.monotonic() > deadline:
            raise RuntimeError(f"the shares have not got {scans} scans within {SETTLED:g} s")
        time.sleep(0.2)


class _Took(NamedTuple):
    """Wall clock, and what the thread that gathers has computed meanwhile, ms."""

    wall: float
    cpu: float


def _timed(gather: Callable[[], object]) -> _Took:
    began, computed = time.perf_counter(), time.thread_time()
    gather()
    return _Took(1000.0 * (time.perf_counter() - began), 1000.0 * (time.thread_time() - computed))


def _p50(name: str, took: Sequence[_Took], target: float | None = None, times: float = 1.0) -> list[Result]:
    """The medians; `times`: to a map of the size that a target is for."""
    wall, cpu = (times * statistics.median(each) for each in zip(*took, strict=True))
    return [
        Result(GROUP, f"{name}, p50", wall, "ms", target, at_least=False),
        Result(GROUP, f"{name}, CPU of the gathering thread, p50", cpu, "ms"),
    ]
