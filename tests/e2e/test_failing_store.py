"""A store whose disk is full, and then is not: who asks is told, and mapping goes on."""

import errno
import signal

import httpx
import numpy as np

from ogm_client import RobotPublisher

SWEEP = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.0, "range_max": 9.0}
STAMP = 10**18


def drive(mapper, eventually, first, last):
    with RobotPublisher("r1", address=mapper.endpoint, run=f"from{first}", reliable=True) as robot:
        robot.wait_for_mapper(30.0)
        for k in range(first, last):
            robot.publish_scan([2.0 + 0.01 * k] * 20, **SWEEP, stamp=STAMP + k, pose=(0.1 * k, 0.0, 0.0))
        eventually(lambda: mapper.status()["revision"] == last)


def readyz(mapper):
    answer = httpx.get(f"{mapper.url}readyz", timeout=30.0)
    return answer.status_code, answer.text


def gauge(mapper, name):
    """A gauge of the mapper's, None if it has none."""
    for line in mapper.get("metrics").decode().splitlines():
        if line.startswith(f"{name}{{"):
            return float(line.split()[1])
    return None


def test_a_full_disk_makes_the_mapper_unready_and_costs_no_map(ogm, eventually, tmp_path, failing_disk):
    control = tmp_path / "control"
    environ = {"LD_PRELOAD": str(failing_disk), "FAILING_DISK": str(control)}
    command = ogm.mapper("--data", "data", **environ)
    mapper = ogm.ready(command)
    drive(mapper, eventually, 0, 5)
    eventually(lambda: mapper.status()["store"]["revision"] == 5)
    size = mapper.status()["store"].pop("bytes")
    assert mapper.status()["store"] == {"revision": 5, "failing": None, "bytes": size}
    assert size == sum((tmp_path / "data" / name).stat().st_size for name in ("map.sqlite", "map.sqlite-wal"))
    assert readyz(mapper) == (200, "ok")
    assert (gauge(mapper, "ogm_stored_revision"), gauge(mapper, "ogm_store_failing")) == (5.0, 0.0)
    told = " ".join(ogm.call("status", "--url", mapper.url).out.split())
    assert "revision 5, 0." in told

    control.write_text(f"write {errno.ENOSPC} 0")
    drive(mapper, eventually, 5, 9)
    _, why = eventually(lambda: (found := readyz(mapper))[0] == 503 and found)
    assert why == "data/map.sqlite: cannot be written: database or disk is full"
    store = mapper.status()["store"]
    assert (store["revision"], store["failing"]) == (5, why)
    assert (gauge(mapper, "ogm_stored_revision"), gauge(mapper, "ogm_store_failing")) == (5.0, 1.0)
    assert gauge(mapper, "ogm_ready") == 0.0
    told = " ".join(ogm.call("status", "--url", mapper.url).out.split())
    assert f"revision 5; {why}" in told
    command.complains(f"{why}: the map goes on in memory; storing it is tried again")
    drive(mapper, eventually, 9, 12)
    assert httpx.get(f"{mapper.url}livez").status_code == 200
    cells = mapper.map()

    control.write_text("")
    eventually(lambda: mapper.status()["store"]["revision"] == 12)
    assert mapper.status()["store"]["failing"] is None
    assert readyz(mapper) == (200, "ok")
    command.process.send_signal(signal.SIGKILL)
    command.process.wait()
    again = ogm.ready(ogm.mapper("--data", "data"))
    assert again.status()["revision"] == 12
    np.testing.assert_array_equal(again.map()["log_odds"], cells["log_odds"], strict=True)


def test_who_stores_no_map_says_nothing_of_a_store(idle_mapper):
    assert "store" not in idle_mapper.status()
    assert gauge(idle_mapper, "ogm_stored_revision") is None
    assert gauge(idle_mapper, "ogm_store_failing") is None
