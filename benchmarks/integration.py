"""How fast scans get into a map: the variants of this project's map beside other programs of its kind.

CPU time of integration alone: the scans are in memory; no messages, no pictures. The maps are compared, too:
the textbook's must be the same, bit for bit.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from benchmarks.agreement import different_cells, same_class
from benchmarks.contenders import Contender, Ours, interleaved, peers
from benchmarks.limit import Limit
from benchmarks.peers.process import Peer
from benchmarks.peers.workload_file import write_workload
from benchmarks.table import Result
from benchmarks.workloads import BIG_SCANS, WORKLOADS, Workload, first_scans, settings_of
from ogm_core.cells.rate import Rate

SCRATCH = Path(__file__).parents[1] / "build" / "benchmarks"
ROUNDS, QUICK_ROUNDS = 8, 2
QUICK_SCANS = BIG_SCANS // 10
OCTOMAP_SCANS, QUICK_OCTOMAP_SCANS = 30, 5
"""OctoMap takes some 80 ms a scan."""
LIMIT_SCANS = 50

BRESENHAM, BRESENHAM_64 = "beam, bresenham, int16", "beam, bresenham, float64"
DDA, SECTOR = "beam, dda, int16", "sector, int16"
RATE = "beam, counted (cell model rate)"
PEERS = {
    "textbook": "textbook in C++",
    "textbook-sized": "textbook in C++, lists sized beforehand",
    "mrpt": "MRPT",
    "octomap": "OctoMap",
}
FAST_PEERS = ("mrpt", "textbook", "textbook-sized")
TARGETS = {
    (BRESENHAM, "mrpt"): 1.25,
    (BRESENHAM, "textbook"): 5.0,
    (BRESENHAM_64, "textbook"): 3.0,
    (DDA, "textbook"): 2.5,
    (SECTOR, "mrpt"): 2.7,
    (SECTOR, "textbook"): 10.0,
}
"""How many times faster than a peer a variant is to be, on workload `big`."""
SMALL_TARGETS = {(BRESENHAM, "mrpt"): 1.1}
"""The same on the others, whose scans are small."""
RATE_AT_MOST = 1.2
"""Times what log odds along Bresenham's lines cost, on workload `big`."""
SECTOR_AT_MOST = 4.0
"""Times the least that sectors cost."""


def run(quick: bool) -> list[Result]:
    """Measure on every workload that is there; `quick`: on the first scans of those that are simulated."""
    SCRATCH.mkdir(parents=True, exist_ok=True)
    results = []
    for name in ("lab", "big") if quick else WORKLOADS:
        work = WORKLOADS[name]()
        if work is None:
            print(f"left out: workload {name}, a recording that is not here")
            continue
        results += measured(first_scans(work, QUICK_SCANS) if quick else work, quick)
    return results


def measured(work: Workload, quick: bool) -> list[Result]:
    """Times and ratios of one workload, and how far the peers' maps are the same."""
    file = SCRATCH / f"{work.name}.workload"
    write_workload(work, file)
    ours = variants(work)
    with ExitStack() as stack:
        fast = [stack.enter_context(peer) for peer in peers(FAST_PEERS, file, SCRATCH)]
        limits = [Limit(work, len(work.scans) // LIMIT_SCANS)] if work.name == "big" else []
        times = interleaved([*fast, *ours, *limits], QUICK_ROUNDS if quick else ROUNDS)
        results = [*timed(work, times), *ratios(work, times), *compared(work, fast, ours)]
    file.unlink()
    return results + octomap(first_scans(work, QUICK_OCTOMAP_SCANS if quick else OCTOMAP_SCANS))


def variants(work: Workload) -> list[Ours]:
    """The map of this project in the forms that are measured."""
    return [
        Ours(BRESENHAM, work, settings_of(work)),
        Ours(f"{BRESENHAM}, new memory", work, settings_of(work), new_memory=True),
        Ours(BRESENHAM_64, work, settings_of(work, cells="float64")),
        Ours(RATE, work, settings_of(work, cell_model=Rate())),
        Ours(DDA, work, settings_of(work, traversal="dda")),
        Ours(SECTOR, work, settings_of(work, sensor_model="sector")),
        Ours(f"{SECTOR}, new memory", work, settings_of(work, sensor_model="sector"), new_memory=True),
    ]


def timed(work: Workload, times: dict[str, float]) -> list[Result]:
    """CPU time of a scan."""
    group = f"integration of {work.name}: CPU time of a scan"
    return [Result(group, PEERS.get(name, name), us, "us") for name, us in times.items()]


def ratios(work: Workload, times: dict[str, float]) -> list[Result]:
    """How many times faster every variant is than the peers that were measured."""
    group = f"integration of {work.name}: times the peer's speed"
    targets = TARGETS if work.name == "big" else SMALL_TARGETS
    found = [
        Result(group, f"{name}, of {PEERS[peer]}", times[peer] / us, "x", targets.get((name, peer)))
        for name, us in times.items()
        for peer in FAST_PEERS
        if name not in PEERS and name != Limit.name and peer in times
    ]
    if work.name == "big" and RATE in times:
        ratio = times[RATE] / times[BRESENHAM]
        group = f"integration of {work.name}: times the CPU time of {BRESENHAM}"
        found.append(Result(group, RATE, ratio, "x", RATE_AT_MOST, at_least=False))
    if Limit.name in times:
        group = f"integration of {work.name}: times the least CPU time"
        ratio = times[SECTOR] / times[Limit.name]
        found.append(Result(group, SECTOR, ratio, "x", SECTOR_AT_MOST, at_least=False))
    return found


def compared(work: Workload, fast: Sequence[Peer], ours: Sequence[Ours]) -> list[Result]:
    """Whether the float64 map is the textbook's, and how much of MRPT's agrees with it."""
    group = f"integration of {work.name}: the same work"
    exact = next(variant for variant in ours if variant.name == BRESENHAM_64)
    results = []
    for peer in fast:
        if peer.name == "mrpt":
            results.append(agreement(group, peer, exact))
            continue
        theirs = f"{PEERS[peer.name]}, from float64"
        updates = abs(peer.updates - exact.grid.cell_updates)
        cells = different_cells(peer, exact.grid, SCRATCH)
        results.append(Result(group, f"difference in cell updates, {theirs}", updates, "", 0, at_least=False))
        results.append(Result(group, f"cells that differ in any bit, {theirs}", cells, "", 0, at_least=False))
    return results


def octomap(work: Workload) -> list[Result]:
    """OctoMap's time for a few scans, and how much of its map agrees."""
    file = SCRATCH / f"{work.name}.workload"
    write_workload(work, file)
    results = []
    with ExitStack() as stack:
        for peer in peers(("octomap",), file, SCRATCH):
            stack.enter_context(peer)
            exact = Ours(BRESENHAM_64, work, settings_of(work, cells="float64"))
            contenders: list[Contender] = [peer, exact]
            times = interleaved(contenders, 2)
            name = f"{PEERS[peer.name]}, the first {len(work.scans)} scans"
            group = f"integration of {work.name}"
            results += [
                Result(f"{group}: CPU time of a scan", name, times[peer.name], "us"),
                agreement(f"{group}: the same work", peer, exact),
            ]
    file.unlink()
    return results


def agreement(group: str, peer: Peer, exact: Ours) -> Result:
    """Share of cells with the same class as in the peer's map."""
    share = same_class(peer, exact.grid, SCRATCH)
    name = f"cells with {PEERS[peer.name]}'s class (occupied, free, undecided), of those known to both"
    return Result(group, name, 100.0 * share, "%")
