"""`python -m benchmarks.checkouts FOLDER`: what a mapper of another checkout costs a scan, beside this one's.

For whoever changes what every scan goes through. Both mappers are sent the same messages, in turns and as
fast as they take them; what counts is the CPU time of each mapper's process, which a busy machine disturbs
least. A scan comes with its pose in a message of its own, as robots send them.
"""

import argparse
import os
import statistics
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from sys import executable

import httpx
import zenoh

from benchmarks.__main__ import machine
from benchmarks.running import HANDLED, ROOT, line_after, program
from benchmarks.workloads import Workload, lab_exercise, whole_big
from ogm_client.session import NetworkConfig, open_session
from ogm_core.types import PoseStamped
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.messages import encode_pose, encode_scan

SCANS, ROUNDS = 2000, 10
PERIOD = 100_000_000
"""Between two scans, ns by their stamps."""
AHEAD = 1000
"""Scans that may be on their way."""
TICKS = os.sysconf("SC_CLK_TCK")


@dataclass
class Mapper:
    """A mapper of one checkout, and what a scan has cost it in each round, s of CPU."""

    pid: int
    url: str
    session: zenoh.Session
    costs: list[float] = field(default_factory=list)

    def handled(self, run: str) -> int:
        """How many scans of a run are in the map; one that is not there is an error."""
        status = httpx.get(f"{self.url}status", timeout=30.0).raise_for_status().json()
        source = status["robots"].get(f"robot-{run}", {"sources": {}})["sources"].get("laser")
        if source is None:
            return 0
        if sum(source["dropped"].values()):
            raise RuntimeError(f"dropped: {source['dropped']}")
        return int(source["integrated"])

    def take(self, messages: list[tuple[bytes, bytes]], run: str) -> None:
        """Send it a round of poses and scans, and note what they cost."""
        httpx.post(f"{self.url}reset", timeout=30.0).raise_for_status()
        keys, before = MapKeys("default"), _cpu(self.pid)
        pose_key, scan_key = keys.pose(f"robot-{run}"), keys.scan(f"robot-{run}", "laser")
        deadline, sent = time.monotonic() + HANDLED, 0
        while (taken := self.handled(run)) < len(messages):
            for pose, scan in messages[sent : taken + AHEAD]:
                for key, payload in ((pose_key, pose), (scan_key, scan)):
                    self.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
            sent = max(sent, min(taken + AHEAD, len(messages)))
            if time.monotonic() >= deadline:
                raise TimeoutError(f"{taken} of {len(messages)} scans were handled within {HANDLED:g} s")
            time.sleep(0.2)
        self.costs.append((_cpu(self.pid) - before) / len(messages))


def _cpu(pid: int) -> float:
    """CPU time of a process, s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


@contextmanager
def mapper_of(folder: Path, preset: str) -> Iterator[Mapper]:
    """The mapper of a checkout that runs."""
    network = ["--http-port", "0", "--listen", "tcp/127.0.0.1:0"]
    command = [
        executable,
        "-m",
        "ogm_services",
        "mapper",
        *network,
        *(["--preset", preset] if preset else []),
    ]
    with program(command, folder=folder) as process:
        endpoint, url = line_after(process, "on Zenoh at "), line_after(process, "live map ")
        with open_session(NetworkConfig(connect=(endpoint,))) as session:
            yield Mapper(process.pid, url, session)


def encoded(work: Workload, run: str) -> list[tuple[bytes, bytes]]:
    """Pose and scan of each step, lap after lap."""
    made = []
    for n in range(SCANS):
        scan, pose, _ = work.scans[n % len(work.scans)]
        stamp = 1_700_000_000_000_000_000 + n * PERIOD
        made.append(
            (
                encode_pose(PoseStamped(stamp, pose, n, run)),
                encode_scan(replace(scan, stamp=stamp, seq=n, run=run, pose=None)),
            )
        )
    return made


def main() -> None:
    """Measure, and print how many times this checkout's cost the other one's is."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.checkouts", description=__doc__)
    parser.add_argument("folder", type=Path, help="the other checkout")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    arguments = parser.parse_args()
    print(f"{machine()}; CPU time of the mapper a scan, {SCANS} scans a round")
    for name, work, preset in (("lab", lab_exercise(), "lab"), ("big", whole_big(), "")):
        with ExitStack() as running:
            here, other = (
                running.enter_context(mapper_of(folder, preset)) for folder in (ROOT, arguments.folder)
            )
            for n in range(arguments.rounds + 1):  # the first warms up
                run = f"{name}-{n}"
                messages = encoded(work, run)
                for mapper in (here, other) if n % 2 else (other, here):
                    mapper.take(messages, run)
        ours, theirs = here.costs[1:], other.costs[1:]
        ratio = statistics.median(b / a for a, b in zip(ours, theirs, strict=True))
        print(
            f"{name}: here {1e6 * min(ours):.0f} us, there {1e6 * min(theirs):.0f} us; there / here: "
            f"{min(theirs) / min(ours):.3f} of the best rounds, {ratio:.3f} median of {len(ours)} pairs"
        )


if __name__ == "__main__":
    main()
