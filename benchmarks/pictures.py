"""How fast a map becomes a PNG file, beside Pillow at its fastest on the grey picture alone.

CPU time of one thread in this process. The first picture is made of a snapshot's cells, as Pillow's is of
an array of greys; what the snapshot took is shown beside it. Pictures after more scans begin at the map
itself, and are compared with a first one that does so, too. The map is `big` in 4000 x 4000 cells.
"""

import io
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.table import Result
from benchmarks.workloads import Workload, mapped, whole_big
from ogm_core.files.map_files import PALETTES, encode_png
from ogm_core.grid import OccupancyGrid
from ogm_core.lattice import Region
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.types import PlacedScan

BOUNDS = Region(-100.0, -100.0, 100.0, 100.0)
ROUNDS, QUICK_ROUNDS = 9, 1
AGAIN = "ros"
"""The palette whose pictures after more scans are looked at."""
SNAPSHOT = "snapshot"
NEAR = 8.0
"""Range of a short-sighted sensor, m; that of the workload is 30."""
SIZE_TARGET, AGAIN_TARGET = 1.15, 3.0
EVERY = 100
"""After so many scans of the lap one more is looked at."""


_T = TypeVar("_T")


@dataclass
class Best:
    """The least CPU time, ms, of what was done in several rounds, by its name."""

    ms: dict[str, float] = field(default_factory=dict)

    def of(self, name: str, work: Callable[[], _T]) -> _T:
        """Do it once more; what it returns."""
        begin = time.thread_time()
        done = work()
        self.add(name, time.thread_time() - begin)
        return done

    def add(self, name: str, seconds: float) -> None:
        """Note one more time that it took."""
        self.ms[name] = min(self.ms.get(name, np.inf), 1e3 * seconds)


def run(quick: bool) -> list[Result]:
    """Measure on workload `big`; `quick`: in fewer rounds."""
    work, best = replace(whole_big(), bounds=BOUNDS), Best()
    sizes: dict[str, int] = {}
    for _ in range(QUICK_ROUNDS if quick else ROUNDS):
        for palette in PALETTES:
            grid, picture = mapped(work), MapPicture(PALETTES[palette])
            draw(grid, palette, picture, best, sizes)
            if palette == AGAIN:
                after_scans(grid, work, picture, best)
    return [*cold(best, sizes), *again(best)]


def draw(grid: OccupancyGrid, palette: str, picture: MapPicture, best: Best, sizes: dict[str, int]) -> None:
    """Make the first picture of a map, and have Pillow make the same one; note times and bytes."""
    snapshot = best.of(SNAPSHOT, grid.snapshot)
    sizes[palette] = len(best.of(palette, lambda: picture.png(snapshot)))
    grey = picture_of(grid, palette)
    sizes[f"Pillow {palette}"] = len(best.of(f"Pillow {palette}", lambda: pillow(grey)))


def picture_of(grid: OccupancyGrid, palette: str) -> NDArray[np.uint8]:
    """The picture that is encoded, uint8, north up."""
    with Image.open(io.BytesIO(encode_png(grid.snapshot(), palette))) as image:
        return np.asarray(image)


def pillow(grey: NDArray[np.uint8]) -> bytes:
    """The picture as Pillow encodes it."""
    file = io.BytesIO()
    Image.fromarray(grey).save(file, "PNG", compress_level=1)
    return file.getvalue()


def after_scans(grid: OccupancyGrid, work: Workload, picture: MapPicture, best: Best) -> None:
    """Make a picture after one more scan, of either range: from several places of the lap."""
    for name, change in (("30 m", lambda placed: placed), ("8 m", short_sighted)):
        for n in range(0, len(work.scans), EVERY):
            placed = change(work.scans[n])
            grid.integrate(placed.scan, placed.pose)
            best.of(f"{name} {n}", lambda: picture.png(grid.snapshot()))


def short_sighted(placed: PlacedScan) -> PlacedScan:
    """The scan of a sensor that sees no farther than NEAR."""
    ranges = np.minimum(placed.scan.ranges, np.float32(NEAR))
    return placed._replace(scan=replace(placed.scan, ranges=ranges, range_max=NEAR))


def cold(best: Best, sizes: dict[str, int]) -> list[Result]:
    """Results of the first picture of a map."""
    group = "PNG of 4000 x 4000 cells, the first of a map: CPU time"
    results = [Result(group, "the snapshot before it", best.ms[SNAPSHOT], "ms")]
    for palette in PALETTES:
        theirs = f"Pillow {palette}"
        speed, size = best.ms[theirs] / best.ms[palette], sizes[palette] / sizes[theirs]
        results += [
            Result(group, f"palette {palette}", best.ms[palette], "ms"),
            Result(group, f"Pillow, compress_level 1, of palette {palette}", best.ms[theirs], "ms"),
            Result(group, f"palette {palette}: times Pillow's speed", speed, "x"),
            Result(
                group,
                f"palette {palette}: the same with the snapshot",
                best.ms[theirs] / (best.ms[SNAPSHOT] + best.ms[palette]),
                "x",
            ),
            Result(group, f"palette {palette}: times Pillow's size", size, "x", SIZE_TARGET, at_least=False),
        ]
    return results


def again(best: Best) -> list[Result]:
    """Results of the next picture, after one more scan: means over the places."""
    group = "PNG of 4000 x 4000 cells after one more scan, its snapshot included: CPU time"
    first, results = best.ms[SNAPSHOT] + best.ms[AGAIN], []
    for reach, target in (("30 m", AGAIN_TARGET), ("8 m", None)):
        ms = float(np.mean([ms for name, ms in best.ms.items() if name.startswith(f"{reach} ")]))
        results += [
            Result(group, f"a scan of 1081 beams up to {reach}", ms, "ms"),
            Result(group, f"up to {reach}: times faster than the first", first / ms, "x", target),
        ]
    return results
