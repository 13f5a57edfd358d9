"""Shares of a map that are killed and frozen, their router, and robots: they hold what one mapper would."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from benchmarks.running import ROOT, environment, line_after
from ogm_client.session import NetworkConfig, open_session, resolve_listen
from ogm_core.files.map_files import encode_npz, read_npz
from ogm_core.lattice import TILE
from ogm_core.wire.keys import MapKeys
from ogm_services.settings.settings import Settings
from tests.gathering import grid_of, parts
from tests.soak.missed import SEED, SETTLED, Happens, Outcome, within
from tests.soak.overload import differing
from tests.soak.services import Mapper, Robots, Service
from tests.soak.share_fleet import ALONE, COUNTS, LOG_ODDS, SHARES, Cells, Pacer, fleet_in, has_all

AT_THE_CUTS = (45, 54, 55, 56, 65)
"""One whose scans all four shares have a part of, and its neighbours."""


def shares_killed(
    folder: Path,
    kills: int,
    *,
    robots: Iterable[int],
    rate: float,
    number: signal.Signals = signal.SIGKILL,
    cells: Cells = ALONE,
) -> Outcome:
    """Kill a share at random so many times, at random moments, while robots start one by one."""
    chance = random.Random(SEED)
    starting = fleet_in(folder, robots, rate, cells=cells, starting=2.0 * kills)
    with starting as fleet, Pacer(fleet):
        for _ in range(kills):
            time.sleep(chance.uniform(0.3, 1.5))
            share, before = chance.choice(fleet.shares), fleet.sent
            share.end(number)
            time.sleep(chance.uniform(0.0, 1.0))
            share.start()
            share.wait_until_ready()
            fleet.found.away.append(fleet.sent - before)
        assert sum(len(share.runs) for share in fleet.shares) == len(SHARES) + kills, "no share was killed"
        return fleet.settled()


def share_frozen(folder: Path, seconds: float, *, robots: Iterable[int], rate: float) -> Outcome:
    """Freeze the share that all robots at the cuts reach for so long; meanwhile three parts are answered."""
    with fleet_in(folder, robots, rate) as fleet:
        fleet.wait_for(20)
        with fleet.shares[3].frozen():
            before = fleet.sent
            time.sleep(seconds)
            fleet.found.away.append(fleet.sent - before)
            with open_session(NetworkConfig(connect=(fleet.endpoint,))) as session:
                answered = parts(session, MapKeys("default"), timeout=10.0)
            assert sorted(answered) == [0, 1, 2], "the token of a share that is frozen is gone"
        return fleet.settled()


def shares_router_killed(folder: Path, away: float, *, robots: Iterable[int], rate: float) -> Outcome:
    """Kill the router, and start it again after so long."""
    with fleet_in(folder, robots, rate) as fleet:
        fleet.wait_for(20)
        fleet.router.end()
        before = fleet.sent
        time.sleep(away)
        fleet.found.away.append(fleet.sent - before)
        fleet.router.start()
        return fleet.settled()


def shares_robots_killed(folder: Path, *, robots: Iterable[int], rate: float) -> Outcome:
    """Kill robots and start them again, as runs of their own; what has not left one then ends with it."""
    robots = tuple(robots)
    with fleet_in(folder, robots, rate) as fleet, ExitStack() as opening:
        fleet.wait_for(20 * len(robots))
        before = fleet.robots.sent()
        fleet.robots.end()
        assert within(SETTLED, lambda: not any(share.anybody_alive for share in fleet.shares))
        arrived = fleet.shares[0].arrived()
        assert all(arrived[robot] >= count for robot, count in before.items()), (arrived, before)
        assert within(SETTLED, lambda: all(share.has_heard() == arrived for share in fleet.shares))
        fleet.over.append(arrived)
        fleet.robots = opening.enter_context(Robots(fleet.endpoint, robots, rate, run=1))
        fleet.wait_for(20 * len(robots))
        return fleet.settled()


def log_across_shares(
    log: Path, built: Path, folder: Path, kills: int, *, rate: float, **flags: object
) -> Outcome:
    """Publish a log at so many scans a second, and kill shares meanwhile: the map is that of `ogm build`.

    `built` is the map.npz that it has made of the log with the same `flags`; `wrong_cells` are cells.
    """
    chance, found, endpoint = random.Random(SEED), Outcome(), resolve_listen("tcp/127.0.0.1:0")
    with ExitStack() as opening:
        opening.enter_context(Service("tests.soak.router", endpoint))
        shares = [Mapper(endpoint, folder / f"share{k}", "connect", flags | {"share": k}) for k in SHARES]
        for share in shares:
            opening.enter_context(share)
        for share in shares:
            share.wait_until_ready()
        replaying = opening.enter_context(Service("tests.soak.replaying", endpoint, log, rate))
        assert within(SETTLED, lambda: _told(replaying)[0] > 0), "nothing is published"
        for _ in range(kills):
            time.sleep(chance.uniform(0.3, 1.0))
            share, before = chance.choice(shares), _told(replaying)[0]
            share.end()
            share.start()
            share.wait_until_ready()
            found.away.append(_told(replaying)[0] - before)
        _, found.sent = _told(replaying)
        within(SETTLED, lambda: all(has_all(share, found.sent) for share in shares))
        revisions = [share.status()["revision"] for share in shares]
        found.integrated = max(revisions, key=lambda revision: abs(revision - found.sent))
        with open_session(NetworkConfig(connect=(endpoint,))) as session:
            gathered_map = parts(session, MapKeys("default"))
        settings = Settings.model_validate({"map": {name: flags[name] for name in ("resolution", "reach")}})
        again = read_npz(encode_npz(grid_of(gathered_map, settings.grid_settings()).snapshot()))
        found.wrong_cells = differing(again, read_npz(built.read_bytes()))
        for share in shares:
            share.end()
        found.counted = sum((share.counted for share in shares), Counter[str]())
        return found


def intel_across_shares(folder: Path, kills: int) -> Outcome:
    """Intel's log at 30 Hz, cut in the middle of its map, which `ogm build` makes of it."""
    log = Path(os.environ["OGM_DATASETS"]) / "intel" / "intel-corrected.log.gz"
    flags = {"resolution": 0.05, "reach": 10.0}
    made_of = [f"--{name}={value}" for name, value in flags.items()]
    command = [sys.executable, "-m", "ogm_services", "build", log, "--out", folder / "built", *made_of]
    subprocess.run(list(map(str, command)), cwd=ROOT, env=environment(), check=True, capture_output=True)
    built = folder / "built" / "map.npz"
    npz = read_npz(built.read_bytes())
    height, width = npz.log_odds.shape
    middle = npz.offset[0] + width // 2, npz.offset[1] + height // 2
    cut_x, cut_y = (round(TILE * (at // TILE) * flags["resolution"], 9) for at in middle)
    return log_across_shares(log, built, folder, kills, rate=30.0, cuts_x=cut_x, cuts_y=cut_y, **flags)


def _told(replaying: Service) -> tuple[int, int]:
    """Scans that were published, and how many there are."""
    assert replaying.process is not None
    replaying.process.stdin.write(b"\n")  # type: ignore[union-attr]
    sent, count = json.loads(line_after(replaying.process, "sent "))
    return sent, count


def fleets(kills: int) -> dict[str, Happens]:
    """What happens at full length, by what it is called; intel's log lies in OGM_DATASETS."""

    def killed(rate: float, cells: Cells) -> Happens:
        return partial(shares_killed, kills=kills, robots=range(100), rate=rate, cells=cells)

    return {
        f"shares killed {kills} times, 100 robots at 2 Hz": killed(2.0, COUNTS),
        f"shares killed {kills} times, 100 robots at 10 Hz": killed(10.0, COUNTS),
        f"shares of log odds killed {kills} times, 100 robots at 10 Hz": killed(10.0, LOG_ODDS),
        f"shares stopped (SIGTERM) {kills} times, 5 robots at 20 Hz": partial(
            shares_killed, kills=kills, robots=AT_THE_CUTS, rate=20.0, number=signal.SIGTERM
        ),
        "a share frozen for 4 s, 100 robots at 2 Hz": partial(
            share_frozen, seconds=4.0, robots=range(100), rate=2.0
        ),
        "the router of shares killed for 1.5 s, 100 robots at 2 Hz": partial(
            shares_router_killed, away=1.5, robots=range(100), rate=2.0
        ),
        "robots of shares killed, 3 at 20 Hz": partial(shares_robots_killed, robots=(45, 55, 65), rate=20.0),
        f"shares killed {max(1, kills // 5)} times, intel's log at 30 Hz": partial(
            intel_across_shares, kills=max(1, kills // 5)
        ),
    }
