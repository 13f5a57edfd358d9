"""A mapper that only notes what it takes, in a file, as a process of its own: it can be killed and frozen.

What it has noted is decided: a message is worked on and stored in one step, as with a map on disk.
"""

import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAP_NAME = "hall"


@dataclass
class Noted:
    """What a file of notes says: messages as (sensor or "pose", run, seq, stamp) by robot, in order."""

    taken: dict = field(default_factory=lambda: defaultdict(list))
    lost: Counter = field(default_factory=Counter)
    replayed: Counter = field(default_factory=Counter)

    @classmethod
    def of(cls, path):
        """Read a file of notes; there may be none yet."""
        noted = cls()
        for line in path.read_text().splitlines() if path.exists() else ():
            what, robot, key, *rest = line.split(" ")
            if what == "taken":
                noted.taken[robot].append((key, rest[0], int(rest[1]), int(rest[2])))
            elif what == "lost":
                noted.lost[robot, key] += int(rest[0])
            else:
                noted.replayed[robot, key] += 1
        return noted

    def seqs(self, robot, key):
        """The seqs of one key in the order in which they were taken."""
        return [seq for name, _, seq, _ in self.taken[robot] if name == key]


class Process:
    """A process of this file that can be killed, frozen, started again: listen, connect, route, robot."""

    def __init__(self, how, endpoint, *arguments):
        self._command = [sys.executable, __file__, how, endpoint, *map(str, arguments)]
        self.process = None

    def start(self):
        """Start it, and wait until it is ready."""
        path = os.pathsep.join(map(str, (ROOT, ROOT / "services", ROOT / "clients")))
        self.process = subprocess.Popen(
            self._command, stdout=subprocess.PIPE, text=True, env={**os.environ, "PYTHONPATH": path}
        )
        assert self.process.stdout.readline() == "ready\n"

    def kill(self):
        """End it as a power cut would."""
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
        self.process = None

    def signal(self, number):
        self.process.send_signal(number)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        if self.process is not None:
            self.process.send_signal(signal.SIGCONT)
            self.kill()


class NotingMapper(Process):
    """One that listens on the endpoint, or connects there, and notes in a file."""

    def __init__(self, endpoint, path, how="listen"):
        super().__init__(how, endpoint, path)
        self._path = path

    @property
    def noted(self):
        """What it has noted, in all its lives."""
        return Noted.of(self._path)


class _Notes:
    """The file of notes: what is decided by it, and what is lost and comes again."""

    def __init__(self, path):
        self._seqs = defaultdict(set)
        self._last = {}
        for robot, messages in Noted.of(path).taken.items():
            for key, run, seq, _ in messages:
                self._decide(robot, key, run, seq)
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def take(self, robot, key, run, seq, stamp):
        self._write(f"taken {robot} {key} {run} {seq} {stamp}")
        self._decide(robot, key, run, seq)

    def is_decided(self, robot, sensor, run, seq):
        return seq in self._seqs[robot, sensor or "pose", run]

    def last(self, robot, sensor, run):
        return self._last.get((robot, sensor or "pose", run))

    def skip(self, robot, sensor, run, first, last):
        for seq in range(first, last + 1):
            self._decide(robot, sensor or "pose", run, seq)

    def scan_lost(self, robot, sensor, count):
        self._write(f"lost {robot} {sensor} {count}")

    def pose_lost(self, robot, count):
        self._write(f"lost {robot} pose {count}")

    def scan_replayed(self, robot, sensor):
        self._write(f"replayed {robot} {sensor}")

    def pose_replayed(self, robot):
        self._write(f"replayed {robot} pose")

    def _decide(self, robot, key, run, seq):
        seqs = self._seqs[robot, key, run]
        seqs.add(seq)
        last = self._last.get((robot, key, run), -1)
        while last + 1 in seqs:
            last += 1
        if last >= 0:
            self._last[robot, key, run] = last

    def _write(self, line):
        os.write(self._file, f"{line}\n".encode())


def route(endpoint):
    """Be a Zenoh router, until the end."""
    import zenoh

    config = zenoh.Config.from_json5(
        f'{{mode: "router", listen: {{endpoints: ["{endpoint}"]}}, '
        "scouting: {multicast: {enabled: false}, gossip: {enabled: false}}}"
    )
    with zenoh.open(config):
        print("ready", flush=True)
        while True:
            time.sleep(60.0)


def be_a_robot(endpoint):
    """Publish poses and scans at 40 Hz until SIGUSR1; then say how many, and stay until the end."""
    from ogm_client import RobotPublisher

    stopping = threading.Event()
    signal.signal(signal.SIGUSR1, lambda *_: stopping.set())
    sweep = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 30.0}
    with RobotPublisher("robot0", address=endpoint, map_name=MAP_NAME) as robot:
        print("ready", flush=True)
        sent = 0
        while not stopping.wait(1.0 / 40.0):
            robot.publish_pose(0.0, 0.0, 0.0, stamp=sent)
            robot.publish_scan([1.0] * 20, sensor="laser", stamp=sent, **sweep)
            sent += 1
        print(sent, flush=True)
        while True:
            time.sleep(60.0)


def note(how, endpoint, path):
    """Note what comes, until the end."""
    from ogm_client.session import NetworkConfig, open_session
    from ogm_core.placing.receipts import Receipts
    from ogm_core.wire.heads import read_head
    from ogm_core.wire.keys import MapKeys
    from ogm_services.mapper.intake.queue import ScanQueue
    from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber

    notes, queue = _Notes(Path(path)), ScanQueue(4096)

    class Placer:
        decided = notes

        def robot_here(self, *_): ...

        def robot_gone(self, *_): ...

    class NotedReceipts(Receipts):
        scan_lost, pose_lost = notes.scan_lost, notes.pose_lost
        scan_replayed, pose_replayed = notes.scan_replayed, notes.pose_replayed

    def work():
        while not queue.closed:
            item = queue.take(0.1)
            if item is None or item.source is None:
                continue
            stamp, seq, run = read_head(item.payload)
            notes.take(item.source.robot, item.source.sensor or "pose", run, seq, stamp)

    network = NetworkConfig(**{how: (endpoint,)}, connect_timeout=60.0)
    with open_session(network) as session:
        keys, receipts = MapKeys(MAP_NAME), NotedReceipts()
        subscriber = ZenohSubscriber(session, keys, queue, receipts, Placer(), max_beams=1000)
        worker = threading.Thread(target=work, daemon=True)
        worker.start()
        subscriber.declare()
        print("ready", flush=True)
        while True:
            time.sleep(60.0)


if __name__ == "__main__":
    if sys.argv[1] == "route":
        route(sys.argv[2])
    elif sys.argv[1] == "robot":
        be_a_robot(sys.argv[2])
    else:
        note(*sys.argv[1:])
