"""Overload: a mapper that is sent ten times what it can take, and everything that does not belong."""

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from subprocess import Popen
from sys import executable
from tempfile import TemporaryDirectory

import httpx
import numpy as np

from benchmarks.running import RunningMapper, line_after, program
from ogm_core.files.map_files import NpzMap, encode_npz, read_npz
from ogm_core.grid import OccupancyGrid
from ogm_core.types import Pose
from ogm_services.settings.settings import Settings
from tests.soak.robots import KINDS, placed

HONEST = tuple(f"honest-{n}" for n in range(4))
HONEST_RATE, HEAVY_RATE, STRANGER_RATE = 20.0, 1.0, 0.5
TIMES = 10
"""So many times what the mapper takes is sent."""
TRIAL = 10.0
"""How long it is measured how much the mapper takes, s."""
DRAINED = 60.0
SAME = 1e-6
"""How far from its true pose a scan may be placed, m or rad: poses are interpolated."""


FLAGS = ("--http-port", "0", "--listen", "tcp/127.0.0.1:0")


@dataclass
class Report:
    """What was held, and what was wrong."""

    seconds: float
    capacity: float
    """Scans of the flood that the mapper takes a second, alone."""
    sent: Counter[str] = field(default_factory=Counter)
    integrated: Counter[str] = field(default_factory=Counter)
    """By robot."""
    status: dict = field(default_factory=dict)
    wrong_cells: int = 0
    misplaced: int = 0
    strangers: int = 0
    """Scans of strangers that are in the map."""
    not_balanced: int = 0
    """Answers in which received was not integrated + pending + dropped."""
    longest_status: float = 0.0
    most_memory: int = 0
    looks: int = 0

    def failures(self) -> list[str]:
        """What must not be."""
        found = [
            f"{count} {what}"
            for count, what in (
                (self.wrong_cells, "wrong cells"),
                (self.misplaced, "misplaced scans"),
                (self.strangers, "scans of strangers in the map"),
                (self.not_balanced, "statuses that do not add up"),
            )
            if count
        ]
        for robot in HONEST:
            share = self.integrated[robot] / max(1, self.sent[robot])
            if share < 0.95:
                found.append(f"{share:.1%} of the scans of {robot} are in the map: at least 95 % are needed")
        return found


def overloaded(seconds: float, trial: float = TRIAL) -> Report:
    """Overload a mapper for so long, s, after a `trial` of what it takes, and look at what is left."""
    with TemporaryDirectory() as folder, ExitStack() as running:
        journal = Path(folder, "journal")
        process = running.enter_context(
            program([executable, "-m", "tests.soak.journal", str(journal), *FLAGS])
        )
        mapper = RunningMapper(line_after(process, "on Zenoh at "), line_after(process, "live map "))
        report = Report(seconds, _capacity(mapper, trial))
        with ExitStack() as sending:
            rates = [f"{robot}:{HONEST_RATE}" for robot in HONEST]
            senders = [
                sending.enter_context(_sender(mapper, seconds, *robots))
                for robots in (
                    rates,
                    [f"flood-0:{TIMES * report.capacity}"],
                    [f"heavy-0:{HEAVY_RATE}"],
                    [f"stranger:{STRANGER_RATE}"],
                )
            ]
            _watch(mapper, process.pid, seconds, report)
            for sender in senders:
                report.sent += _sent(sender)
        _drain(mapper, report)
        served = httpx.get(f"{mapper.url}map.npz", timeout=60.0).raise_for_status().content
        _compare(served, journal, report)
        return report


@contextmanager
def _sender(mapper: RunningMapper, seconds: float, *robots: str) -> Iterator[Popen[bytes]]:
    command = [executable, "-m", "tests.soak.senders", mapper.endpoint, mapper.url, str(seconds), *robots]
    with program(command) as process:
        yield process


def _sent(sender: Popen[bytes]) -> Counter[str]:
    """What a sender has sent, once it is done."""
    assert sender.stdout is not None
    return Counter(json.loads(sender.stdout.read()))


def _capacity(mapper: RunningMapper, trial: float) -> float:
    """Scans a second that the mapper takes of a flood that has it to itself."""
    with _sender(mapper, trial, "flood-trial:1e6") as sender:
        _sent(sender)
    _drain(mapper, None)
    status = _status(mapper)
    return status["scans"]["integrated"] / trial


def _status(mapper: RunningMapper) -> dict:
    return httpx.get(f"{mapper.url}status", timeout=30.0).raise_for_status().json()


def _watch(mapper: RunningMapper, pid: int, seconds: float, report: Report) -> None:
    """Ask as an operator would, once a second."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        began = time.monotonic()
        _look(_status(mapper), report)
        report.longest_status = max(report.longest_status, time.monotonic() - began)
        report.most_memory = max(report.most_memory, _memory(pid))
        httpx.get(f"{mapper.url}map.png", timeout=30.0)
        time.sleep(max(0.0, began + 1.0 - time.monotonic()))


def _look(status: dict, report: Report) -> None:
    scans = status["scans"]
    report.looks += 1
    report.status = status
    gone = scans["integrated"] + scans["pending"] + sum(scans["dropped"].values())
    report.not_balanced += scans["received"] != gone


def _drain(mapper: RunningMapper, report: Report | None) -> None:
    """Wait until the mapper has handled what it has."""
    deadline = time.monotonic() + DRAINED
    while (status := _status(mapper))["scans"]["pending"]:
        if time.monotonic() >= deadline:
            raise TimeoutError(f"scans still wait after {DRAINED:g} s: {status['scans']}")
        time.sleep(0.2)
    if report is not None:
        _look(status, report)


def _memory(pid: int) -> int:
    """Resident memory of a process, bytes."""
    pages = int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096


def _compare(served: bytes, journal: Path, report: Report) -> None:
    """Make the map again of exactly the scans that are in it, and count the cells that differ."""
    grid = OccupancyGrid(Settings().grid_settings(), "again")
    for line in journal.read_text(encoding="utf-8").splitlines():
        run, number, *pose = line.split(" ")
        report.integrated[run] += 1
        if run.partition("-")[0] not in KINDS:
            report.strangers += 1
            continue
        known, here = placed(run, int(number)), Pose(*map(float, pose))
        report.misplaced += max(map(abs, np.subtract(here, known.pose))) > SAME
        grid.integrate(known.scan, here)
    report.wrong_cells = differing(read_npz(served), read_npz(encode_npz(grid.snapshot())))


def differing(served: NpzMap, again: NpzMap) -> int:
    """Cells that are not the same; all of them where not even the rectangle is."""
    if (served.offset, served.log_odds.shape) != (again.offset, again.log_odds.shape):
        return max(served.log_odds.size, again.log_odds.size)
    return int((~np.isclose(served.log_odds, again.log_odds, rtol=0.0, atol=0.0, equal_nan=True)).sum())
