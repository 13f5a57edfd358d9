"""What a program sees that follows a map while its mapper is killed and started again."""

import signal
from concurrent.futures import ThreadPoolExecutor

import pytest

from ogm_client import MapClient, RobotPublisher

SWEEP = {"angle_min": 0.0, "angle_increment": 0.5, "range_min": 0.0, "range_max": 9.0}


def put_scan(mapper, eventually):
    with RobotPublisher("r1", address=mapper.endpoint) as robot:
        robot.wait_for_mapper(30.0)
        robot.publish_scan([1.0, 2.0], **SWEEP, stamp=10**18, pose=(0.0, 0.0, 0.0))
        eventually(lambda: mapper.status()["revision"] == 1)


@pytest.mark.parametrize("over", ["zenoh", "http"])
def test_a_watch_goes_on_with_the_mapper_that_takes_the_place(ogm, endpoint, eventually, over):
    first = ogm.ready(ogm.mapper("--listen", endpoint))
    port = first.url.rstrip("/").rpartition(":")[2]
    address = endpoint if over == "zenoh" else first.url
    with MapClient(address) as client, ThreadPoolExecutor(1) as pool:
        put_scan(first, eventually)
        maps = client.watch(interval=0.02)
        seen = next(maps)
        assert (seen.run, seen.revision) == (first.status()["run"], 1)
        waiting = pool.submit(next, maps)
        first.command.process.send_signal(signal.SIGKILL)
        first.command.process.wait()
        second = ogm.ready(ogm.mapper("--listen", endpoint, "--http-port", port))
        run = second.status()["run"]
        grid = waiting.result(timeout=60.0)
        assert (grid.run, grid.revision) == (run, 0)
        put_scan(second, eventually)
        grid = pool.submit(next, maps).result(timeout=60.0)
        assert (grid.run, grid.revision, grid.width) == (run, 1, seen.width)
        assert run != seen.run
