"""What a recorder that is killed has recorded: all but the last moment, as robots at 20 Hz count it."""

import random
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from ogm_client.session import resolve_listen
from ogm_core.errors import BadRecording
from ogm_core.logs.recorded import RecordedScan
from ogm_services.recorder.repair import repair_recording
from ogm_services.ros2.mcap_reader import McapReader
from tests.soak.missed import SEED, SETTLED, within
from tests.soak.services import Robots, Service

RATE = 20.0
ROBOT = 1


@dataclass
class Killed:
    """What the files of recorders that were killed held."""

    kills: int = 0
    scans: int = 0
    """That could be read back, of all files."""
    most_lost: int = 0
    """Scans that the robot had published when a recorder was killed, and that its file has not."""
    gaps: int = 0
    """Files in which a scan is missing, or there twice, before the last one."""
    not_repaired: int = 0
    """Files that, made whole, do not hold the same."""

    def failures(self) -> list[str]:
        """What was wrong; more than a second's scans lost is."""
        failures = [f"{self.most_lost} scans at {RATE:g} Hz were lost"] if self.most_lost > RATE else []
        failures += [f"{self.gaps} recordings with gaps"] if self.gaps else []
        return failures + ([f"{self.not_repaired} were not made whole"] if self.not_repaired else [])


def recorders_killed(seconds: float) -> Killed:
    """Kill recorders of a robot, one after the other, at random moments, for as long."""
    found, moments, end = Killed(), random.Random(SEED), time.monotonic() + seconds
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    with ExitStack() as opening:
        opening.enter_context(Service("tests.soak.router", endpoint))
        robots = opening.enter_context(Robots(endpoint, range(ROBOT, ROBOT + 1), RATE))
        folder = Path(opening.enter_context(tempfile.TemporaryDirectory()))
        while time.monotonic() < end or not found.kills:
            path = folder / f"{found.kills}.mcap"
            with Service("ogm_services", "record", "--connect", endpoint, "-o", path) as recorder:
                assert within(SETTLED, lambda path=path: _is_live(path, robots)), "it does not record"
                time.sleep(moments.uniform(0.0, 2.0))
                sent = robots.sent()[ROBOT]
                recorder.end()
            _look(found, path, sent)
            path.unlink()
    return found


def _is_live(path: Path, robots: Robots) -> bool:
    """Whether what was published long ago is recorded, and what is published is."""
    return path.exists() and len(_seqs(path)) > 0 and robots.sent()[ROBOT] - _seqs(path)[-1] <= RATE


def _look(found: Killed, path: Path, sent: int) -> None:
    seqs = _seqs(path)
    found.kills += 1
    found.scans += len(seqs)
    found.most_lost = max(found.most_lost, sent - seqs[-1] - 1)
    found.gaps += seqs != list(range(seqs[0], seqs[0] + len(seqs)))
    repair_recording(path)
    with McapReader(path) as reader:
        again = [each.message.seq for each in reader if isinstance(each, RecordedScan)]
        found.not_repaired += again != seqs or reader.doubt != ""


def _seqs(path: Path) -> list[int]:
    """Of the scans that can be read."""
    with McapReader(path) as reader:
        try:
            return [each.message.seq for each in reader if isinstance(each, RecordedScan)]
        except BadRecording:  # there is none yet
            return []
