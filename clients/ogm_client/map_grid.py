"""Occupancy grid map at one revision: an array of cells that knows where it lies in the world."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ogm_client.grid_queries import GridQueries
from ogm_client.missing_shares import MissingShare
from ogm_client.notebook import html_of
from ogm_client.plot import current_axes, plot_map
from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.classes import trinary
from ogm_core.cells.log_odds import PLANE, LogOdds, probability_of
from ogm_core.cells.model import StoredCells
from ogm_core.cells.thresholds import FREE_BELOW
from ogm_core.errors import BadParameter
from ogm_core.files.file_names import check_suffix, ros_map_names
from ogm_core.files.map_files import (
    MAX_NPZ_BYTES,
    encode_pgm,
    encode_png,
    encode_yaml,
    load_npz,
    own_free_below,
)
from ogm_core.lattice import Lattice, Region
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import RobotStatus
from ogm_core.whole_files import whole_file, write_files

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True, eq=False)
class MapGrid(GridQueries):
    """Log odds of the cells of a rectangle of the map, and where it lies.

    Arrays are [iy, ix], shape (height, width), row 0 is the south edge. Two kinds of index meet here:

    - a cell's own (ix, iy), the same in every reply, whatever part of the map it shows: `world_to_cell`,
      `offset`, and /cell speak of it;
    - the place in this grid's arrays, which counts from the lower-left cell, `offset`. So the cell (ix, iy)
      is `grid.log_odds[iy - grid.offset[1], ix - grid.offset[0]]`; `at(x, y)` does that.

    `log_odds` is ln(p / (1 - p)) of "occupied", NaN where unknown; float64 of a float64 map, else float32.
    `resolution` is metres per cell; `anchor` the world position of the lower-left corner of cell (0, 0), m;
    `epoch`, `run` (of the mapper's process) and `revision` name the map's state together; `stamp` is its
    newest scan's, ns since the Unix epoch, or None. Cells of p < `free_below` are free.
    `missing` names the shares that are not in it, of a map that is cut: it has no `epoch`, `run` and
    `revision` then. A notebook shows a grid as a picture with a scale bar.
    """

    log_odds: NDArray[np.floating[Any]]
    resolution: float
    anchor: tuple[float, float]
    offset: tuple[int, int]
    epoch: str
    revision: int
    stamp: int | None
    run: str = ""
    free_below: float = FREE_BELOW
    missing: tuple[MissingShare, ...] = ()

    @classmethod
    def from_snapshot(cls, snapshot: MapSnapshot) -> "MapGrid":
        """The map of a snapshot, as a mapper that had taken it would send it.

            grid = OccupancyGrid(GridSettings())  # of ogm_core, in a program without mapper and network
            MapGrid.from_snapshot(grid.snapshot()).save_png("map.png")

        Raises:
            BadParameter: the snapshot was shrunk, so that its pixels are no cells.
        """
        if snapshot.factor != 1:
            raise BadParameter(
                f"snapshot: cells are needed, got blocks of {snapshot.factor} x {snapshot.factor}"
            )
        place = snapshot.lattice.resolution, snapshot.lattice.anchor, snapshot.offset
        log_odds = snapshot.model.arrays(snapshot.stored).get(PLANE)
        if log_odds is None:  # a model that keeps something else
            log_odds = np.where(snapshot.published()[1], snapshot.log_odds(), np.nan)
        version = snapshot.epoch, snapshot.revision, snapshot.stamp
        return cls(log_odds, *place, *version, snapshot.run, snapshot.model.free_below)

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, max_bytes: int = MAX_NPZ_BYTES) -> "MapGrid":
        """The map in a file that `save_npz`, `ogm build` or `ogm get map.npz` wrote, value for value.

        The file does not name the map's state: `epoch` and `run` are "", `revision` 0, `stamp` None. The
        cells may take `max_bytes` of memory.

        Raises:
            BadMapFile: it cannot be read, holds something else or too much; the text says what is wrong.
        """
        npz = load_npz(Path(path), max_bytes=max_bytes)
        place = npz.resolution, npz.anchor, npz.offset
        return cls(npz.log_odds, *place, epoch="", revision=0, stamp=None, free_below=npz.free_below)

    @property
    def width(self) -> int:
        """Columns, cells along x."""
        return int(self.log_odds.shape[1])

    @property
    def height(self) -> int:
        """Rows, cells along y."""
        return int(self.log_odds.shape[0])

    @property
    def origin(self) -> tuple[float, float]:
        """World position of the lower-left corner of this grid, m."""
        return self._lattice.corner_of(*self.offset)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which cells a beam has ever updated; computed on each access, like the other arrays below."""
        unknown: NDArray[np.bool_] = np.isnan(self.log_odds)
        return ~unknown

    @property
    def probability(self) -> NDArray[np.float64]:
        """Probability of "occupied", NaN where unknown."""
        return probability_of(self.log_odds)

    @property
    def occupancy(self) -> NDArray[np.int8]:
        """100 where occupied (p > 0.65), 0 where free (p < free_below), -1 where undecided or unknown."""
        return trinary(self.probability, self.known, self.free_below)

    def world_to_cell(self, x: float, y: float) -> tuple[int, int]:
        """The own index (ix, iy) of the cell that holds the point (x, y), m, be it in this grid or not.

        Raises:
            BadParameter: the point is not finite, or too far away for cells to be told apart.
        """
        return self._lattice.cell_of(x, y)

    def at(self, x: float, y: float) -> float:
        """Probability of "occupied" at the point (x, y), m; NaN where unknown or outside this grid.

        Raises:
            BadParameter: as `world_to_cell`.
        """
        ix, iy = self.world_to_cell(x, y)
        column, row = ix - self.offset[0], iy - self.offset[1]
        if not (0 <= column < self.width and 0 <= row < self.height):
            return math.nan
        return float(probability_of(self.log_odds[row : row + 1, column])[0])

    def crop(self, region: ArrayLike) -> "MapGrid":
        """The part that covers `region`: (xmin, ymin, xmax, ymax), m, rounded outward to cells; a copy.

        What lies outside this grid is left out. An empty grid crops to itself.

        Raises:
            BadParameter: the region is not four finite numbers, inverted, or wholly outside this grid.
        """
        # Cropping moves cells without reading them, so they may stay as they are.
        part = self._snapshot_of(self.log_odds).crop(_region(region))
        return replace(self, log_odds=part.cells.copy(), offset=part.offset)

    def to_png(self, palette: str = "ros", max_size: int | None = None) -> bytes:
        """A PNG, north up, a pixel per cell.

        `palette`, in 8-bit greys: "ros": 0 occupied, 254 free, 205 undecided or unknown; "probability":
        brighter is more likely occupied, 127 unknown; in colours: "cividis", "dark", "costmap" (as RViz
        draws it). With `max_size` no side is longer, in pixels: cells are joined in
        square blocks, where occupied wins, then free.

        Raises:
            MapEmpty: there is no cell to draw.
            BadParameter: no such palette, or `max_size` is below 1.
        """
        snap = self.to_snapshot()
        return encode_png(snap if max_size is None else snap.shrink(max_size), palette)

    def save_png(
        self, path: str | os.PathLike[str], palette: str = "ros", max_size: int | None = None
    ) -> None:
        """Write what `to_png` gives.

        Raises:
            MapEmpty: there is no cell to draw.
            BadParameter: as `to_png`; or the name is that of another format, such as a.jpg.
            OSError: the file cannot be written; what was there before is still there.
        """
        check_suffix(Path(path), ".png")
        write_files({Path(path): self.to_png(palette, max_size)})

    def save_npz(self, path: str | os.PathLike[str]) -> None:
        """Write a NumPy archive of the arrays that the mapper's own map.npz holds.

        Raises:
            BadParameter: the name is that of another format, such as a.png.
            OSError: the file cannot be written; what was there before is still there.
        """
        check_suffix(Path(path), ".npz")
        with whole_file(Path(path)) as file:  # given a path, numpy would add a suffix of its own
            arrays: dict[str, NDArray[Any]] = {
                "log_odds": self.log_odds,
                "resolution": np.array(self.resolution),
                "origin": np.array(self.origin),
                "offset": np.array(self.offset, np.int64),
                "anchor": np.array(self.anchor),
            }
            np.savez_compressed(file, allow_pickle=False, **arrays, **own_free_below(self.free_below))

    def save_ros_map(self, path: str | os.PathLike[str]) -> None:
        """Write the pair that ROS 2 nav2 map_server loads, NAME.yaml and, beside it, NAME.pgm.

        `path` is one of the two (or NAME.yml), or NAME alone.

        Raises:
            MapEmpty: there is no cell to draw.
            BadParameter: the name is that of another format, or not text.
            OSError: the files cannot be written; what was there before is still there.
        """
        picture, target = ros_map_names(Path(path))
        snap = self.to_snapshot()
        encoded = encode_pgm(snap)
        description = encode_yaml(snap, picture.name, encoded)
        write_files({picture: encoded, target: description})

    def to_snapshot(self) -> MapSnapshot:
        """The map as `ogm_core` has it, to cut, shrink and encode it; its cells are float64 log odds."""
        # As the core stores them: a known log odds of zero is -0.0, unknown +0.0.
        exact = self.log_odds.astype(np.float64)
        return self._snapshot_of(np.where(self.known, np.where(exact == 0.0, -0.0, exact), 0.0))

    def plot(self, ax: "Axes | None" = None, *, robots: Mapping[str, RobotStatus] | None = None) -> "Axes":
        """Draw the map with matplotlib, in metres; return the axes.

            grid.plot(robots=mapper.status().robots).figure.savefig("map.pdf")

        `ax` None: the axes that pyplot draws into. Black is occupied, white free; what is unknown is light
        blue. `robots` are drawn where they were last, but for those that are gone. No side has more than 2000
        pixels: cells are joined in square blocks, where occupied wins, then free.

        Raises:
            MapEmpty: there is no cell to draw.
            MissingExtra: matplotlib is not installed.
        """
        axes = current_axes() if ax is None else ax
        plot_map(axes, self.to_snapshot(), robots or {})
        return axes

    @property
    def _lattice(self) -> Lattice:
        return Lattice(self.resolution, self.anchor)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return html_of(self.to_snapshot())

    def _snapshot_of(self, cells: StoredCells) -> MapSnapshot:
        model = LogOdds(cells="float64", free_below=self.free_below)
        stored = CellArrays.of(model, cells)
        place = self._lattice, self.offset
        return MapSnapshot(stored, model, *place, self.epoch, self.revision, self.stamp, run=self.run)


def _region(values: Any) -> Region:  # noqa: ANN401 - an ArrayLike, or a mistake
    try:
        xmin, ymin, xmax, ymax = map(float, values)
    except (TypeError, ValueError) as error:
        raise BadParameter(
            f"region: four numbers xmin, ymin, xmax, ymax are needed, got {values!r}"
        ) from error
    return Region(xmin, ymin, xmax, ymax)
