"""How long a mapper takes to be ready, beside the least that Python needs to load what it is made of."""

import subprocess
import sys
import time
import urllib.request
from statistics import median

from benchmarks.running import ROOT, STARTED, environment, line_after, mapper, ogm
from benchmarks.table import Result

ROUNDS, QUICK_ROUNDS = 11, 1
IMPORTS = "import numpy, numba, zenoh, fastapi"
TARGET = 4.0


def run(quick: bool) -> list[Result]:
    """Measure with all caches warm; `quick`: in fewer rounds."""
    with mapper():  # compiles
        pass
    imports()
    ready, least = [], []
    for _ in range(QUICK_ROUNDS if quick else ROUNDS):
        ready.append(until_ready())
        least.append(imports())
    group = "start, caches warm: medians"
    return [
        Result(group, "ogm mapper, until /readyz says 200", 1e3 * median(ready), "ms"),
        Result(group, f"python -c '{IMPORTS}'", 1e3 * median(least), "ms"),
        Result(group, "times that", median(ready) / median(least), "x", TARGET, at_least=False),
    ]


def until_ready() -> float:
    """Time, s, from starting a mapper until it is ready: nobody asks before it says so itself."""
    begin = time.perf_counter()
    with ogm("mapper", "--http-port", "0", "--listen", "tcp/127.0.0.1:0") as process:
        url = line_after(process, "live map ")
        with urllib.request.urlopen(f"{url}readyz", timeout=STARTED) as answer:
            assert answer.status == 200
        return time.perf_counter() - begin


def imports() -> float:
    """Time, s, of a Python that imports the largest of what a mapper is made of, and ends."""
    begin = time.perf_counter()
    subprocess.run([sys.executable, "-c", IMPORTS], check=True, cwd=ROOT, env=environment(), timeout=STARTED)
    return time.perf_counter() - begin
