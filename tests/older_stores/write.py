"""`python tests/older_stores/write.py`: writes the store of this version's format, for later ones to go on.

Once for a format, by the version that brings it: format<N>/ has what a mapper stored (map.sqlite), the map
that it served (map.npz), and what it said of it (status.json).
"""

import io
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import numpy as np

from ogm_client import RobotPublisher
from ogm_services.mapper.storage.layout import FILE, VERSION

LOG_ODDS = ("--resolution", "0.1", "--sensor-model", "beam", "--traversal", "bresenham", "--cells", "int16")
OF_FORMAT = {
    1: LOG_ODDS,
    2: (*LOG_ODDS, "--half-life", "1"),
    3: ("--resolution", "0.25", "--cell-model", "rate", "--separate-robots"),
}
"""Flags that a mapper needs for maps of a format; in 2 and 3 something was erased, in 3 a robot left out."""
SWEEP = {"angle_min": -np.pi, "angle_increment": np.pi / 45, "range_min": 0.1, "range_max": 6.0}
STAMP = 1_700_000_000_000_000_000
RUN = "run1"
SCANS = 12


def publish(robot, first, last):
    """Scans of a sensor with a pose before and after each, under seqs of their own."""
    bearings = SWEEP["angle_min"] + SWEEP["angle_increment"] * np.arange(90)
    robot.publish_pose(0.2 * first, 0.0, 0.1 * first, stamp=STAMP + first * 10**8)
    for k in range(first, last):
        ranges = 4.0 + np.sin(3.0 * bearings + k) + np.where(bearings > 2.5, np.inf, 0.0)
        robot.publish_scan(ranges.astype(np.float32), **SWEEP, stamp=STAMP + k * 10**8 + 10**7)
        robot.publish_pose(0.2 * (k + 1), 0.0, 0.1 * (k + 1), stamp=STAMP + (k + 1) * 10**8)


def main():
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder, "data")
        command = [sys.executable, "-m", "ogm_services", "mapper", "--http-port", "0"]
        command += ["--listen", "tcp/127.0.0.1:0", "--data", data, *OF_FORMAT[VERSION]]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as mapper:
            endpoint, url = (re.search(r"(\S+)$", mapper.stdout.readline())[1] for _ in range(2))
            with RobotPublisher("r1", address=endpoint, run=RUN, reliable=True) as robot:
                robot.wait_for_mapper(30.0)
                publish(robot, 0, SCANS)
                status(url, lambda said: said["scans"]["integrated"] == SCANS)
                for k, other in enumerate(("r2", "r3")):
                    with RobotPublisher(other, address=endpoint, run=RUN, reliable=True) as one:
                        one.wait_for_mapper(30.0)
                        publish(one, k, k + 2)
                        status(url, lambda said, k=k: said["scans"]["integrated"] == SCANS + 2 * k + 2)
                body(url, "robots/r3", "DELETE")
                body(url, "erase?region=1,-1,2,1", "POST")
                served, coarse = body(url, "map.npz"), body(url, "map.npz?resolution=coarse")
                known = np.count_nonzero(~np.isnan(np.load(io.BytesIO(coarse))["log_odds"]))
                # The count of known cells may be some seconds old.
                said = status(url, lambda said: said["map_info"]["known_cells"] == known)
                files = {"map.npz": served, "status.json": said}
            mapper.send_signal(signal.SIGTERM)
        out = Path(__file__).with_name(f"format{VERSION}")
        out.mkdir()
        shutil.copy(data / FILE, out / FILE)
        for name, content in files.items():
            (out / name).write_bytes(content)


def status(url, wanted):
    """The status, once it is as wanted."""
    while not wanted(json.loads(said := body(url, "status"))):
        time.sleep(0.01)
    return said


def body(url, path, method="GET"):
    request = urllib.request.Request(url + path, method=method)
    with urllib.request.urlopen(request, timeout=30) as answer:
        return answer.read()


if __name__ == "__main__":
    main()
