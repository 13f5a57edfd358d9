"""What a mapper misses while it, or what carries its messages, is away: all of it is in its map in the end.

`ogm mapper --data` and robots, each a process, one of which is killed, frozen or stopped. The map is held
against the one that the robots' scans make where nothing ever goes wrong.
"""

import random
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from ogm_client.session import resolve_listen
from ogm_core.files.map_files import read_npz
from tests.soak.drives import uninterrupted
from tests.soak.overload import differing
from tests.soak.services import Mapper, Robots, Service

SETTLED = 60.0
"""How long a mapper may take until it has taken everything, s."""
SEED = 13
POSE_FIRST = range(1, 8, 2)
"""Robots that publish a pose before the scan that waits for it: wherever they stop, no scan is left alone."""
Happens = Callable[[Path], "Outcome"]
TELLING = {"resolution": 0.1, "l_min": -1e6, "l_max": 1e6, "cells": "float64", "p_free": 0.41}
"""Cells that are sums without clamps, rounded after each scan: one that is missing, twice or late shows."""


@dataclass
class Outcome:
    """What became of the scans of all robots, and what shows that there was something to miss."""

    sent: int = 0
    integrated: int = 0
    wrong_cells: int = 0
    away: list[int] = field(default_factory=list)
    """Of every fault, scans that were published while the mapper could not take them."""
    counted: Counter[str] = field(default_factory=Counter)
    """Of all the mapper's lives: scans dropped by reason, odd poses, and what was lost and came again."""

    hz: float | None = None
    """Scans that a robot has published a second, where they were slowed down to what could be taken."""

    @property
    def lost(self) -> int:
        """Scans and poses that nobody had any more."""
        return self.counted["scans lost"] + self.counted["poses lost"]

    @property
    def replayed(self) -> int:
        """Scans and poses that came again."""
        return self.counted["scans replayed"] + self.counted["poses replayed"]

    @property
    def dropped(self) -> dict[str, int]:
        """Scans that were dropped, by reason, and odd poses by what is odd about them."""
        others = ("scans lost", "poses lost", "scans replayed", "poses replayed")
        return {what: count for what, count in self.counted.items() if count and what not in others}

    @property
    def right(self) -> bool:
        """Whether each scan is in the map once, at its place, and nothing else is."""
        return (self.integrated, self.dropped, self.lost, self.wrong_cells) == (self.sent, {}, 0, 0)


@dataclass
class Scene:
    """A mapper, its robots, and maybe a router between them."""

    mapper: Mapper
    robots: Robots
    router: Service | None
    found: Outcome = field(default_factory=Outcome)
    over: list[dict[int, int]] = field(default_factory=list)
    """Scans of each robot in runs that are over."""

    @property
    def sent(self) -> int:
        """Scans that all robots of this run have published."""
        return sum(self.robots.sent().values())

    def note_away(self, count: int) -> None:
        """Note what the mapper could not take during a fault."""
        assert count > 0, "nothing was published meanwhile"
        self.found.away.append(count)

    def settled(self) -> Outcome:
        """Stop the robots, wait until the mapper has all, and compare."""
        runs = [*self.over, self.robots.stop()]
        sent = {robot: [run[robot] for run in runs] for robot in runs[-1]}
        self.found.sent = sum(map(sum, sent.values()))
        within(SETTLED, lambda: self._has_all(self.found.sent))
        served, self.found.integrated = self.mapper.map()
        self.found.wrong_cells = differing(read_npz(served), uninterrupted(sent, self.robots.rate, TELLING))
        self.mapper.end()
        self.found.counted = self.mapper.counted
        return self.found

    def _has_all(self, count: int) -> bool:
        status = self.mapper.status()
        return status["revision"] >= count and not status["scans"]["pending"]


def within(seconds: float, condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds; whether it does, in time."""
    deadline = time.monotonic() + seconds
    while not (holds := condition()) and time.monotonic() < deadline:
        time.sleep(0.1)
    return holds


@contextmanager
def _scene(
    folder: Path,
    robots: range,
    rate: float,
    *,
    starting: float = 0.0,
    routed: bool = False,
) -> Iterator[Scene]:
    """These robots at so many scans a second, that start within so many seconds; one has begun."""
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    with ExitStack() as opening:
        router = opening.enter_context(Service("tests.soak.router", endpoint)) if routed else None
        mapper = Mapper(endpoint, folder / "data", "connect" if routed else "listen", TELLING)
        opening.enter_context(mapper).wait_until_ready()
        driving = opening.enter_context(Robots(endpoint, robots, rate, within=starting))
        scene = Scene(mapper, driving, router)
        _wait_for_scans(scene, len(robots) if starting == 0.0 else 1)
        yield scene


def _wait_for_scans(scene: Scene, count: int) -> None:
    assert within(SETTLED, lambda: scene.sent >= count), "the robots do not publish"


def mapper_killed(
    folder: Path,
    kills: int,
    *,
    robots: int,
    rate: float,
    number: signal.Signals = signal.SIGKILL,
) -> Outcome:
    """Kill the mapper so many times, at random moments, every fifth time before it is ready; or stop it.

    Robots start one by one, so that each begins at another moment of the mapper's.
    """
    moments, ready = random.Random(SEED), 1
    with _scene(folder, range(robots), rate, starting=3.0 * kills) as scene:
        for kill in range(kills):
            time.sleep(moments.uniform(0.0, 2.5))
            before = scene.sent
            scene.mapper.end(number)
            time.sleep(moments.uniform(0.0, 1.0))
            scene.mapper.start()
            if kill % 5 != 1 or kill == kills - 1 or number != signal.SIGKILL:
                scene.mapper.wait_until_ready()
                ready += 1
            scene.note_away(scene.sent - before)
        assert len(scene.mapper.runs) == ready, "a mapper was not killed"
        return scene.settled()


def mapper_frozen(folder: Path, seconds: float, *, robots: int, rate: float) -> Outcome:
    """Freeze the mapper for so long."""
    with _scene(folder, range(robots), rate) as scene:
        _wait_for_scans(scene, 20 * robots)
        with scene.mapper.frozen():
            before = scene.sent
            time.sleep(seconds)
            scene.note_away(scene.sent - before)
        found = scene.settled()
        assert b"the mapper stood still for" in scene.mapper.log_file.read_bytes()
        return found


def robots_frozen(folder: Path, seconds: float, *, rate: float) -> Outcome:
    """Freeze robots for so long, and until the mapper takes them for gone."""
    with _scene(folder, POSE_FIRST, rate) as scene:
        _wait_for_scans(scene, 20 * len(POSE_FIRST))
        with scene.robots.frozen():
            time.sleep(seconds)
            assert within(SETTLED, lambda: not scene.mapper.anybody_alive)
        received = scene.mapper.status()["scans"]["received"]
        _wait_for_scans(scene, received + len(POSE_FIRST))
        return scene.settled()


def robots_killed(folder: Path, kills: int, *, rate: float) -> Outcome:
    """Kill robots, and start them again, as runs of their own; what has not left one then ends with it."""
    moments = random.Random(SEED)
    with _scene(folder, POSE_FIRST, rate) as scene, ExitStack() as opening:
        for number in range(1, kills + 1):
            _wait_for_scans(scene, 20 * len(POSE_FIRST))
            before = scene.robots.sent()
            time.sleep(moments.uniform(0.2, 1.0))
            scene.robots.end()
            assert within(SETTLED, lambda: not scene.mapper.anybody_alive)
            arrived = scene.mapper.arrived()
            assert all(arrived[robot] >= count for robot, count in before.items()), (arrived, before)
            scene.over.append(arrived)
            again = Robots(scene.robots.endpoint, POSE_FIRST, rate, run=number)
            scene.robots = opening.enter_context(again)
        _wait_for_scans(scene, 20 * len(POSE_FIRST))
        return scene.settled()


def router_killed(folder: Path, kills: int, *, robots: int, rate: float) -> Outcome:
    """Kill the router between robots and mapper so many times, and start it again."""
    moments = random.Random(SEED)
    with _scene(folder, range(robots), rate, routed=True) as scene:
        assert scene.router is not None
        for _ in range(kills):
            time.sleep(moments.uniform(1.0, 3.0))
            scene.router.end()
            time.sleep(moments.uniform(0.2, 1.5))
            scene.note_away(scene.sent - scene.mapper.status()["scans"]["received"])
            scene.router.start()
        return scene.settled()


def robots_stopped(folder: Path, *, robots: int, rate: float, routed: bool = False) -> Outcome:
    """Robots that publish no more, but are there, while mapper or router is away: nothing new ever comes."""
    with _scene(folder, range(robots), rate, routed=routed) as scene:
        _wait_for_scans(scene, 20 * robots)
        away = scene.mapper if scene.router is None else scene.router
        before = scene.sent
        away.end()
        _wait_for_scans(scene, before + 20 * robots)
        scene.note_away(sum(scene.robots.stop().values()) - before)
        away.start()
        if scene.router is None:
            scene.mapper.wait_until_ready()
        return scene.settled()


def scenes(kills: int) -> dict[str, Happens]:
    """What happens at full length, by what it is called; the first one has ten times as many kills."""

    def killed(kills: int, robots: int, rate: float, number: signal.Signals = signal.SIGKILL) -> Happens:
        return partial(mapper_killed, kills=kills, robots=robots, rate=rate, number=number)

    return {
        f"the mapper killed {10 * kills} times, a robot at 40 Hz": killed(10 * kills, 1, 40.0),
        f"the mapper killed {kills} times, 100 robots at 2 Hz": killed(kills, 100, 2.0),
        f"the mapper killed {kills} times, 100 robots at 10 Hz": killed(kills, 100, 10.0),
        f"the mapper stopped (SIGTERM) {kills} times, 4 robots at 40 Hz": killed(
            kills, 4, 40.0, signal.SIGTERM
        ),
        "the mapper frozen for 10 s, a robot at 40 Hz": partial(
            mapper_frozen, seconds=10.0, robots=1, rate=40.0
        ),
        "the mapper frozen for 10 s, 100 robots at 10 Hz": partial(
            mapper_frozen, seconds=10.0, robots=100, rate=10.0
        ),
        "4 robots at 40 Hz frozen for 10 s": partial(robots_frozen, seconds=10.0, rate=40.0),
        f"4 robots at 40 Hz killed {kills} times": partial(robots_killed, kills=kills, rate=40.0),
        f"the router killed {kills} times, 4 robots at 40 Hz": partial(
            router_killed, kills=kills, robots=4, rate=40.0
        ),
        f"the router killed {kills} times, 100 robots at 10 Hz": partial(
            router_killed, kills=kills, robots=100, rate=10.0
        ),
        "4 robots at 40 Hz that stop while the mapper is away": partial(robots_stopped, robots=4, rate=40.0),
        "4 robots at 40 Hz that stop while the router is away": partial(
            robots_stopped, robots=4, rate=40.0, routed=True
        ),
    }
