"""How much maps of recorded buildings know, in bits a held-out beam: counts, log odds, and a peer's rule."""

import os
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.karto_rule import karto_map
from benchmarks.table import Result
from ogm_core.grid import OccupancyGrid
from ogm_core.quality.held_out_beams import beams_of
from ogm_core.quality.judged_map import JudgedMap
from ogm_core.quality.judgement import judge_by
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_feed import LogFeed, LogSink
from ogm_services.commands.log_readers import ReadAs, log_reader
from ogm_services.commands.map_variants import variants
from ogm_services.settings.settings import MapSettings, Settings

BUILDINGS = {
    "intel": ("intel/intel-corrected.log.gz", 1),
    "freiburg-079, every 5th scan": ("freiburg-079/freiburg-079-corrected.log.gz", 5),
}
NO_RETURN, REACH = 79.0, 25.0
"""Readings from the first on mean "no return"; no beam writes farther than the second; m."""
ABOVE_LOG_ODDS, ABOVE_PEER = 0.7, 0.12
"""By so many bits counts are to be better."""


@dataclass
class _Scans(LogSink):
    """The scans of a log, those that are mapped and those that are held out."""

    withheld: set[Scan] = field(default_factory=set)
    mapped: list[PlacedScan] = field(default_factory=list)
    held: list[PlacedScan] = field(default_factory=list)
    robot: str = ""

    def integrate(self, scan: Scan, pose: Pose, sweep: Sweep | None = None) -> int:
        """Keep a scan."""
        (self.held if scan in self.withheld else self.mapped).append(PlacedScan(scan, pose, sweep))
        return 0


def run(quick: bool) -> list[Result]:
    """Judge maps of all BUILDINGS that are there; `quick`: of the first."""
    datasets = os.environ.get("OGM_DATASETS")
    if not datasets:
        print("left out: map_quality, OGM_DATASETS does not name the folder of the recorded buildings")
        return []
    results = []
    for name, (log, every) in list(BUILDINGS.items())[: 1 if quick else None]:
        results += judged(f"bits a held-out beam: {name}", Path(datasets, log), every)
    return results


def judged(group: str, log: Path, every: int) -> list[Result]:
    """Bits of the maps of one log, and how far counts are above the others."""
    settings = Settings(map=MapSettings(reach=REACH, clear_range=REACH))
    scans = _Scans()
    with log_reader(log, ReadAs(range_max=NO_RETURN), settings)() as messages:
        LogFeed(settings, HeldScans(10, every)).run(messages, scans, "reading")
    beams = beams_of(scans.held, settings.grid_settings())
    maps = {"hits and passes counted (Karto's rule)": karto_map(scans.mapped, settings.grid_settings())}
    for name, of in variants("bresenham,rate", settings).items():
        grid = OccupancyGrid(of.grid_settings())
        for placed in scans.mapped:
            grid.integrate(*placed)
        maps[name] = JudgedMap.of(grid.snapshot())
    judgements = {name: judge_by(one, beams) for name, one in maps.items()}
    bits = {name: one.bits or 0.0 for name, one in judgements.items()}
    results = [Result(group, name, value, "bits") for name, value in bits.items()]
    results += [Result(group, f"{name}: hit", one.walls.hit or 0.0, "") for name, one in judgements.items()]
    rate, *others = bits["rate"], bits["bresenham"], bits["hits and passes counted (Karto's rule)"]
    for name, value, target in (
        ("rate, above bresenham", others[0], ABOVE_LOG_ODDS),
        ("rate, above Karto's rule", others[1], ABOVE_PEER),
    ):
        results.append(Result(group, name, rate - value, "bits", target))
    return results
