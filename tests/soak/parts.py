"""Parts of the soak: what each of them runs, its tables, and what was wrong."""

import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.running import ROOT
from docs.variants import markdown
from tests.soak.http_schema import requests_made_up
from tests.soak.missed import Happens, Outcome, scenes
from tests.soak.overload import HONEST, HONEST_RATE, Report, overloaded
from tests.soak.recorded import recorders_killed
from tests.soak.shares import fleets

FULL = 600.0
"""How long each load is at full length, s."""
_CORE = ("hostile_messages", "hostile_files", "messages", "jsonlines", "carmen", "decimals", "unpacking")
PROPERTIES = (*(f"tests/core/test_{name}.py" for name in _CORE), "tests/clients/test_hostile_status.py")


@dataclass(frozen=True)
class Part:
    """Tables by their names in docs/guarantees.md, and what was wrong."""

    tables: dict[str, str] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)


def examples(seconds: float) -> Part:
    """Hypothesis' examples of every property of decoders and readers: 10,000 each at full length."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "auto", "-o", "faulthandler_timeout=0"]
    profile, number = ("soak", "10,000") if seconds >= FULL else ("busy", "100")
    done = _program([*command, "-m", "hypothesis", "--hypothesis-profile", profile, *PROPERTIES])
    passed = re.search(r"(\d+) passed", done.stdout)
    if done.returncode or passed is None:
        return Part(wrong=[f"pytest ended with {done.returncode}:\n{done.stdout}{done.stderr}"])
    return Part({"examples": markdown([["properties", "examples of each"], [passed[1], number]])})


def files(seconds: float) -> Part:
    """Files that are mutated, and read by every reader in turn."""
    done = _program([sys.executable, "tests/mutated_files.py", str(seconds)])
    if done.returncode:
        return Part(wrong=[f"a reader ended with {done.returncode}:\n{done.stdout}{done.stderr}"])
    *kinds, memory = (line.partition(": ") for line in done.stdout.splitlines())
    rows = [["file", "mutated files", "what readers made of them"]]
    for kind, _colon, said in kinds:
        total = sum(int(part.split()[0]) for part in said.split(", "))
        rows.append([kind, f"{total:,}", said])
    return Part({"files": markdown(rows) + f"\nMost memory of the reading process: {memory[2]}.\n"})


def stores(seconds: float) -> Part:
    """Stored maps that are damaged at random places: 300 at full length."""
    done = _program([sys.executable, "tests/tampering.py", str(max(20, round(seconds / FULL * 300)))])
    if done.returncode:
        return Part(wrong=[f"a damaged store:\n{done.stdout}{done.stderr}"])
    heads = ["damage", "an exact state", "refused; repaired: exactly", "in part", "not at all"]
    rows = [line.split("; ") for line in done.stdout.splitlines()]
    rows = [[row[0].replace("_", " "), *row[1:]] for row in rows]
    total = ["**all**", *(f"**{sum(int(row[k]) for row in rows)}**" for k in range(1, 5))]
    return Part({"stores": markdown([heads, *rows, total])})


def _program(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)


def http(seconds: float) -> Part:
    """Requests that are made up from the description of the routes."""
    made, failed = requests_made_up(seconds / 2.0)
    table = markdown([["requests made up", "failures"], [f"{made:,}", str(failed)]])
    return Part({"http": table}, [f"{failed} requests"] if failed else [])


def overload(seconds: float) -> Part:
    """Ten times what the mapper takes, with everything that does not belong."""
    report = overloaded(seconds)
    tables = {"load": _load(report), "bad": _bad(report), "dropped": _dropped(report)}
    return Part(tables, report.failures())


def missed(seconds: float) -> Part:
    """Mappers, robots and routers that are killed and frozen, robots that stop: 320 times in all.

    Two of these at a time: the first one takes as long as all others.
    """
    table, wrong = _happened(scenes(max(1, round(20 * seconds / FULL))), at_once=2, wrong="wrong cells")
    return Part({"missed": table}, wrong)


def shares(seconds: float) -> Part:
    """Shares of a map, their router and robots that are killed and frozen, one after the other."""
    table, wrong = _happened(fleets(max(1, round(20 * seconds / FULL))), at_once=1, wrong="wrong tiles")
    return Part({"shares": table}, wrong)


def _happened(happening: dict[str, Happens], *, at_once: int, wrong: str) -> tuple[str, list[str]]:
    """Let all of it happen: a table, and what was wrong; `wrong` is what the last column counts."""
    heads = ["what happened", "scans sent", "meanwhile", "integrated", "dropped", "lost", "came again"]
    rows, failures = [[*heads, wrong]], []
    with ThreadPoolExecutor(at_once) as pool:
        outcomes = {what: pool.submit(_outcome, what, happens) for what, happens in happening.items()}
    for what, outcome in outcomes.items():
        if (error := outcome.exception()) is not None:
            failures.append(f"{what}: {error!r}")
            continue
        found = outcome.result()
        dropped = ", ".join(f"{count:,} {reason}" for reason, count in found.dropped.items())
        away = f"{sum(found.away):,}" if found.away else "-"
        counts = f"{found.lost:,}", f"{found.replayed:,}", f"{found.wrong_cells:,}"
        what += f" ({found.hz:.3g} reached)" if found.hz else ""
        rows.append([what, f"{found.sent:,}", away, f"{found.integrated:,}", dropped or "0", *counts])
        if not found.right:
            failures.append(f"{what}: {found}")
    return markdown(rows), failures


def recorded(seconds: float) -> Part:
    """Recorders that are killed while a robot publishes at 20 Hz."""
    found = recorders_killed(seconds)
    heads = ["recorders killed", "scans read back", "most scans lost at a kill", "gaps", "not made whole"]
    row = [found.kills, found.scans, found.most_lost, found.gaps, found.not_repaired]
    return Part({"recorded": markdown([heads, [f"{count:,}" for count in row]])}, found.failures())


def _outcome(what: str, happens: Happens) -> Outcome:
    with tempfile.TemporaryDirectory() as folder:
        found = happens(Path(folder))
    print(f"{what}: {found}", flush=True)
    return found


def _load(report: Report) -> str:
    received = report.status["scans"]["received"] / report.seconds
    share = min(report.integrated[robot] / max(1, report.sent[robot]) for robot in HONEST)
    rows = [
        ["what", "held"],
        ["time", f"{report.seconds:.0f} s"],
        ["scans sent by one robot of 16 sensors", f"{report.sent['flood-0'] / report.seconds:,.0f} a second"],
        [
            "... of which the mapper can take, if it has nothing else to do",
            f"{report.capacity:,.0f} a second",
        ],
        ["scans of 200,000 beams of 100 m", f"{report.sent['heavy-0']}"],
        ["scans received in all", f"{received:,.0f} a second"],
        [f"least of {len(HONEST)} honest robots at {HONEST_RATE:g} Hz in the map", f"{share:.1%}"],
        ["most memory of the mapper", f"{report.most_memory / 1e6:,.0f} MB"],
        ["longest wait for /status", f"{report.longest_status:.2f} s"],
        ["statuses that do not add up", f"{report.not_balanced} of {report.looks}"],
        ["scans at a place where their robot was not", f"{report.misplaced}"],
        ["scans of strangers in the map", f"{report.strangers}"],
        ["**wrong cells**", f"**{report.wrong_cells}** of {report.status['map_info']['known_cells']:,}"],
    ]
    return markdown(rows)


def _bad(report: Report) -> str:
    robots = {name for name in report.sent if re.fullmatch(r"(honest|flood|heavy)-\w+", name)}
    kinds = Counter({kind: count for kind, count in report.sent.items() if kind not in robots})
    return markdown([["bad input", "times"], *([kind, f"{count:,}"] for kind, count in kinds.items())])


def _dropped(report: Report) -> str:
    dropped = report.status["scans"]["dropped"]
    return markdown([["dropped as", "scans"], *([reason, f"{n:,}"] for reason, n in dropped.items() if n)])


PARTS: dict[str, Callable[[float], Part]] = {
    "examples": examples,
    "files": files,
    "http": http,
    "stores": stores,
    "overload": overload,
    "missed": missed,
    "shares": shares,
    "recorded": recorded,
}
