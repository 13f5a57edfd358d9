"""`python -m benchmarks`: run the benchmarks, show their table and keep it, the targets in docs, too.

`--quick` takes fewer scans and rounds; its table goes to build/benchmarks, as does that of some benchmarks
chosen by their names. What a stored map and tiles cost stands in docs/stored.md and
docs/tiles.md, if it is not measured quickly.
"""

import argparse
import importlib
import importlib.util
import platform
from collections.abc import Callable
from pathlib import Path
from typing import cast

import numpy as np

from benchmarks.table import Result, as_text, keep, targets
from docs.variants import with_table

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
PAGES = {name: ROOT / "docs" / f"{name}.md" for name in ("stored", "tiles")}
"""Pages with the table of one benchmark, by its name."""
BENCHMARKS = (
    "integration",
    "threads",
    "gather",
    "shares",
    "receiving",
    "throughput",
    "latency",
    "pictures",
    "queries",
    "tiles",
    "live",
    "page",
    "http_load",
    "hostile_http",
    "build_speed",
    "batch",
    "memory",
    "map_quality",
    "stored",
    "ros2",
    "start_up",
)
"""Modules of this package, each with `run(quick: bool) -> list[Result]`."""


def main() -> None:
    """Run the benchmarks that the command line names, or all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"one of: {', '.join(BENCHMARKS)}")
    parser.add_argument("--quick", action="store_true", help="fewer scans and rounds")
    arguments = parser.parse_args()
    if unknown := set(arguments.names) - set(BENCHMARKS):
        parser.error(f"no benchmark of the name {', '.join(sorted(unknown))}")
    results: list[Result] = []
    for name in arguments.names or BENCHMARKS:
        run = benchmark(name)
        if run is None:
            print(f"{name}: not there, left out")
            continue
        found = run(arguments.quick)
        if name in PAGES and not arguments.quick:
            show(PAGES[name], name, f"Measured on {machine()}.\n\n{targets(found)}")
        results += found
    print(as_text(results))
    whole = not (arguments.quick or arguments.names)
    folder = ROOT / ("benchmarks/results" if whole else "build/benchmarks")
    keep(results, folder, f"Measured on {machine()}")
    if whole:
        show(PAGE, "speed", targets(results))
    print(f"kept in {folder.relative_to(ROOT)}")


def show(page: Path, name: str, table: str) -> None:
    """Write a table into a page, between its marks."""
    page.write_text(with_table(page.read_text("utf-8"), name, table), encoding="utf-8")


def benchmark(name: str) -> Callable[[bool], list[Result]] | None:
    """The `run` of a module of this package; None if there is no such module."""
    module = f"benchmarks.{name}"
    if importlib.util.find_spec(module) is None:
        return None
    return cast(Callable[[bool], list[Result]], importlib.import_module(module).run)


def machine() -> str:
    """Processor, Python and numpy."""
    processor = platform.processor() or platform.machine()
    for line in _lines(Path("/proc/cpuinfo")):
        if line.startswith("model name"):
            processor = line.partition(":")[2].strip()
            break
    return f"{processor}, Python {platform.python_version()}, numpy {np.__version__}"


def _lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


if __name__ == "__main__":
    main()
