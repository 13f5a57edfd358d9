"""`python -m tests.soak`: the long versions of what the tests hold, and the tables of docs/guarantees.md.

Eight parts, each of them alone by its name: `examples` (hypothesis), `files` (mutated files), `http` (made-up
requests, by the description of the routes), `stores` (stored maps that are damaged), `overload`, `missed`
(mappers and routers that are killed), `shares` (those of shares of a map) and `recorded` (recorders that
are). Tables are kept of what ran at full length: ten minutes, 10,000 examples, and 300 damaged stores.
"""

import argparse
import time
from pathlib import Path

from benchmarks.__main__ import machine
from docs.variants import with_table
from tests.soak.parts import FULL, PARTS

PAGE = Path(__file__).parents[2] / "docs" / "guarantees.md"


def main() -> int:
    """Run the parts that the command line names, or all; 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak", description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"one of: {', '.join(PARTS)}")
    parser.add_argument("--minutes", type=float, default=FULL / 60.0, help="of each part (%(default)g)")
    arguments = parser.parse_args()
    if unknown := set(arguments.parts) - set(PARTS):
        parser.error(f"no part of the name {', '.join(sorted(unknown))}")
    at_length = arguments.minutes * 60.0 >= FULL
    wrong: list[str] = []
    for name in arguments.parts or PARTS:
        began = time.monotonic()
        part = PARTS[name](arguments.minutes * 60.0)
        print(f"{name}: {time.monotonic() - began:.0f} s")
        for table, rows in part.tables.items():
            print(rows)
            if at_length:
                PAGE.write_text(with_table(PAGE.read_text("utf-8"), table, rows), encoding="utf-8")
        wrong += [f"{name}: {text}" for text in part.wrong]
    if at_length:
        note = f"Measured on {machine()}.\n"
        PAGE.write_text(with_table(PAGE.read_text("utf-8"), "machine", note), encoding="utf-8")
    for text in wrong:
        print(f"WRONG: {text}")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
