"""Robots of the soak, a process: `python -m tests.soak.driving ENDPOINT RUN RATE WITHIN SIGHT ROBOT...`.

Each robot publishes poses and scans on keys of their own at RATE Hz; they start one by one within so many
seconds, and wait for nobody. For each line that it is sent the process says `sent`, and as JSON how many
scans each robot has published, and at how many Hz; after the line `stop` none of them publishes any more,
and after `pace` and a number all of them do so many times as fast. What they have published is kept until
the process ends, as it does when its standard input does.
"""

import json
import random
import sys
import threading
import time
from contextlib import ExitStack

from ogm_client.channels import Channels
from ogm_client.session import NetworkConfig, open_session
from ogm_core.types import PoseStamped
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.messages import encode_pose
from tests.soak import drives

CACHED_S = 120.0
"""What robots keep, s: more than a busy machine takes for a few starts in a row that are killed at once."""
_ROBOTS_A_SESSION = 10
_LOOK = 0.1
"""So often a robot that waits for its turn looks whether the pace is another one, s."""


class Clock:
    """Time that goes at a pace: 1, as all clocks do, or less. Any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pace, self._at, self._since = 1.0, 0.0, time.monotonic()

    def now(self) -> float:
        """How late it is, s."""
        with self._lock:
            return self._now()

    def set_pace(self, pace: float) -> None:
        """Go on at another pace."""
        with self._lock:
            self._at, self._since, self._pace = self._now(), time.monotonic(), pace

    def until(self, due: float) -> float:
        """How long it is until then, as other clocks go, s; at most until it has to be asked anew."""
        with self._lock:
            return min(_LOOK, (due - self._now()) / self._pace)

    def _now(self) -> float:
        return self._at + self._pace * (time.monotonic() - self._since)


class Drivers:
    """Robots that publish from threads of this process, until `stop`."""

    def __init__(
        self, endpoint: str, run: str, rate: float, within: float, sight: str, robots: list[int]
    ) -> None:
        self.sent = dict.fromkeys(robots, 0)
        self.clock = Clock()
        self._endpoint, self._run, self._rate, self._sight = endpoint, run, rate, sight
        self._stopping = threading.Event()
        self._began: dict[int, float] = {}
        rng = random.Random(len(robots))
        starts = {n: within * k / len(robots) + rng.random() / rate for k, n in enumerate(robots)}
        groups = [robots[k : k + _ROBOTS_A_SESSION] for k in range(0, len(robots), _ROBOTS_A_SESSION)]
        self._open = ExitStack()
        self._threads = [
            threading.Thread(target=self._drive, args=({n: starts[n] for n in group},)) for group in groups
        ]
        for thread in self._threads:
            thread.start()

    def hz(self) -> float:
        """Scans that a robot has published a second, on average, since each began; 0: none has."""
        now = time.monotonic()
        lasted = sum(now - began for began in list(self._began.values()))
        return sum(self.sent.values()) / lasted if lasted else 0.0

    def stop(self) -> None:
        """Publish no more; what was published is still kept."""
        self._stopping.set()
        for thread in self._threads:
            thread.join()

    def close(self) -> None:
        """Go away."""
        self.stop()
        self._open.close()

    def _drive(self, starts: dict[int, float]) -> None:
        network = NetworkConfig(connect=(self._endpoint,), connect_timeout=60.0)
        session = self._open.enter_context(open_session(network))
        robots: dict[int, Channels] = {}
        turns = sorted((start, robot) for robot, start in starts.items())
        while not self._stopping.is_set():
            due, robot = turns[0]
            if (left := self.clock.until(due)) > 0.0:
                self._stopping.wait(left)
                continue
            if robot not in robots:
                robots[robot] = self._channels(session, robot)
            self._publish(robots[robot], robot)
            turns[0] = due + 1.0 / self._rate, robot
            turns.sort()

    def _channels(self, session, robot: int) -> Channels:
        channels = Channels(
            *(session, MapKeys("default"), f"robot{robot}", self._run, self._endpoint),
            reliable=False,
            cache_samples=round(CACHED_S * self._rate),
        )
        self._open.callback(channels.close)
        self._began[robot] = time.monotonic()
        self._put_pose(channels, robot, 0)
        return channels

    def _publish(self, channels: Channels, robot: int) -> None:
        """The next scan and pose: those of every second robot the other way round."""
        number = self.sent[robot] + 1
        if robot % 2:
            self._put_pose(channels, robot, number)
        payload = drives.encoded_scan(robot, number, self._run, self._rate, self._sight)
        channels.scan(drives.SENSOR).put(payload, self._run, number - 1)
        if not robot % 2:
            self._put_pose(channels, robot, number)
        self.sent[robot] = number

    def _put_pose(self, channels: Channels, robot: int, number: int) -> None:
        stamp = drives.pose_stamp(number, self._rate)
        pose = PoseStamped(stamp, drives.pose(robot, number), number, self._run)
        channels.pose().put(encode_pose(pose), self._run, number)


def main(endpoint: str, run: str, rate: str, within: str, sight: str, *robots: str) -> None:
    """Drive until standard input ends."""
    numbers = [int(robot) for robot in robots]
    drivers = Drivers(endpoint, run, float(rate), float(within), sight, numbers)
    for line in sys.stdin:
        if line == "stop\n":
            drivers.stop()
        elif line.startswith("pace "):
            drivers.clock.set_pace(float(line.split()[1]))
        print("sent", json.dumps([drivers.sent, drivers.hz()]), flush=True)
    drivers.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
