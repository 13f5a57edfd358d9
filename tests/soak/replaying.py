"""A recorded log that a process publishes steadily: `python -m tests.soak.replaying ENDPOINT LOG RATE`.

It publishes so many scans a second and the poses between them, begins at once, and keeps all. For each line
that it is sent it says `sent`, and how many scans of how many it has published; it ends with its input.
"""

import json
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.logs.recorded import Recorded, RecordedPose
from ogm_services.commands.log_readers import AS_IT_SAYS, log_reader
from ogm_services.settings.settings import Settings

RUN = "replayed"


class Replaying:
    """A thread that publishes, until `close`."""

    def __init__(self, endpoint: str, log: Path, rate: float) -> None:
        with log_reader(log, AS_IT_SAYS, Settings())() as reader:
            self._messages = list(reader)
        self.scans = sum(not isinstance(message, RecordedPose) for message in self._messages)
        self.sent = 0
        self._rate = rate
        self._open = ExitStack()
        network = NetworkConfig(connect=(endpoint,), connect_timeout=60.0)
        self._session = self._open.enter_context(open_session(network))
        self._robots: dict[str, RobotPublisher] = {}
        self._seqs: Counter[tuple[str, str | None]] = Counter()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._publish_all)
        self._thread.start()

    def close(self) -> None:
        """Go away."""
        self._stopping.set()
        self._thread.join()
        self._open.close()

    def _publish_all(self) -> None:
        due = time.monotonic()
        for message in self._messages:
            if not isinstance(message, RecordedPose):
                due += 1.0 / self._rate
                if self._stopping.wait(max(0.0, due - time.monotonic())):
                    return
            self._publish(message)

    def _publish(self, recorded: Recorded) -> None:
        robot = self._robots.get(recorded.robot)
        if robot is None:
            robot = RobotPublisher(
                recorded.robot, session=self._session, run=RUN, cache_samples=len(self._messages)
            )
            self._robots[recorded.robot] = self._open.enter_context(robot)
        sensor = None if isinstance(recorded, RecordedPose) else recorded.sensor
        seq = self._seqs[recorded.robot, sensor]  # its own may be missing
        self._seqs[recorded.robot, sensor] += 1
        if isinstance(recorded, RecordedPose):
            robot.put_pose(replace(recorded.message, run=RUN, seq=seq))
        else:
            robot.put_scan(recorded.sensor, replace(recorded.message, run=RUN, seq=seq))
            self.sent += 1


def main(endpoint: str, log: str, rate: str) -> None:
    """Publish until standard input ends."""
    replaying = Replaying(endpoint, Path(log), float(rate))
    for _ in sys.stdin:
        print("sent", json.dumps([replaying.sent, replaying.scans]), flush=True)
    replaying.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
