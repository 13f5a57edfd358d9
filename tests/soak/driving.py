"""Robots of the soak, a process: `python -m tests.soak.driving ENDPOINT RUN RATE WITHIN ROBOT...`.

Each robot publishes poses and scans on keys of their own at RATE Hz; they start one by one within so many
seconds, and wait for nobody. For each line that it is sent the process says `sent`, and as JSON how many
scans each robot has published; after the line `stop` none of them publishes any more. What they have
published is kept until the process ends, as it does when its standard input does.
"""

import json
import random
import sys
import threading
import time
from contextlib import ExitStack

from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from tests.soak import drives

CACHED_S = 120.0
"""What robots keep, s: more than a busy machine takes for a few starts in a row that are killed at once."""
_ROBOTS_A_SESSION = 10


class Drivers:
    """Robots that publish from threads of this process, until `stop`."""

    def __init__(self, endpoint: str, run: str, rate: float, within: float, robots: list[int]) -> None:
        self.sent = dict.fromkeys(robots, 0)
        self._endpoint, self._run, self._rate = endpoint, run, rate
        self._stopping = threading.Event()
        began, rng = time.monotonic(), random.Random(len(robots))
        starts = {n: began + within * k / len(robots) + rng.random() / rate for k, n in enumerate(robots)}
        groups = [robots[k : k + _ROBOTS_A_SESSION] for k in range(0, len(robots), _ROBOTS_A_SESSION)]
        self._open = ExitStack()
        self._threads = [
            threading.Thread(target=self._drive, args=({n: starts[n] for n in group},)) for group in groups
        ]
        for thread in self._threads:
            thread.start()

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
        robots: dict[int, RobotPublisher] = {}
        turns = sorted((start, robot) for robot, start in starts.items())
        while not self._stopping.wait(max(0.0, turns[0][0] - time.monotonic())):
            due, robot = turns.pop(0)
            if robot not in robots:
                robots[robot] = self._publisher(session, robot)
            self._publish(robots[robot], robot)
            turns.append((due + 1.0 / self._rate, robot))
            turns.sort()

    def _publisher(self, session, robot: int) -> RobotPublisher:
        publisher = RobotPublisher(
            f"robot{robot}", session=session, run=self._run, cache_samples=round(CACHED_S * self._rate)
        )
        self._open.enter_context(publisher)
        publisher.publish_pose(*drives.pose(robot, 0), stamp=drives.pose_stamp(0, self._rate))
        return publisher

    def _publish(self, publisher: RobotPublisher, robot: int) -> None:
        """The next scan and pose: those of every second robot the other way round."""
        number = self.sent[robot] + 1
        if robot % 2:
            publisher.publish_pose(*drives.pose(robot, number), stamp=drives.pose_stamp(number, self._rate))
        publisher.publish_scan(
            drives.ranges(robot, number),
            **drives.SWEEP,
            sensor=drives.SENSOR,
            stamp=drives.scan_stamp(number, self._rate),
        )
        if not robot % 2:
            publisher.publish_pose(*drives.pose(robot, number), stamp=drives.pose_stamp(number, self._rate))
        self.sent[robot] = number


def main(endpoint: str, run: str, rate: str, within: str, *robots: str) -> None:
    """Drive until standard input ends."""
    drivers = Drivers(endpoint, run, float(rate), float(within), [int(robot) for robot in robots])
    for line in sys.stdin:
        if line == "stop\n":
            drivers.stop()
        print("sent", json.dumps(drivers.sent), flush=True)
    drivers.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
