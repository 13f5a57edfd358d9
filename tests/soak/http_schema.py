"""HTTP as described: schemathesis makes up requests from /openapi.json, and checks their answers by it."""

import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.running import map_scans, mapper
from tests.soak.robots import lap

_CONFIGURATION = """
[checks.positive_data_acceptance]
# A region may be inverted, or miss the map, of names there is a snapshot or not, and what fits a schema
# may be too long, and what a validator names may be there, or not: no schema can say so.
expected-statuses = ["2xx", 304, 400, 404, 409, 412, 413, 414]

[checks.negative_data_rejection]
# What does not fit may be too long, besides.
expected-statuses = [400, 401, 403, 404, 405, 406, 411, 413, 415, 422]
"""


def requests_made_up(seconds: float) -> tuple[int, int]:
    """Let schemathesis ask a mapper for so long, s; how many cases it made up, and how many failed."""
    program = Path(sys.executable).with_name("schemathesis")
    if not program.exists():
        raise FileNotFoundError(f"{program}: pip install '.[soak]' brings it")
    with TemporaryDirectory() as folder, mapper("--data", f"{folder}/map") as running:
        map_scans(running, lap("flood"))
        Path(folder, "schemathesis.toml").write_text(_CONFIGURATION, encoding="utf-8")
        command = [program, "run", f"{running.url}openapi.json", "--checks", "all", "--continue-on-failure"]
        command += ["--max-time", str(round(seconds)), "--warnings", "off", "--no-color"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return _counted(done)


def _counted(done: subprocess.CompletedProcess[str]) -> tuple[int, int]:
    line = re.search(r"(\d+) generated(?:, (\d+) found \d+ unique failures)?", done.stdout)
    if line is None or (done.returncode != 0) != (line[2] is not None):
        raise RuntimeError(f"schemathesis ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    if done.returncode:
        print(done.stdout)
    return int(line[1]), int(line[2] or 0)
