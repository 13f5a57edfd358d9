"""Settings of an `OccupancyGrid`: what a map is made of. Light: loads no kernels."""

import math
import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from ogm_core.cells.forgetting import tick_length
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.model import MAX_MARGIN, CellModel
from ogm_core.errors import SMALLER_MAP, BadSetting, LimitReached
from ogm_core.lattice import MIN_RESOLUTION, CellRect, Clip, Lattice, Region, bounded
from ogm_core.shares import Share

Outside = Literal["clip", "drop"]
SensorModel = Literal["beam", "sector"]
CellModelName = Literal["log_odds", "rate"]
Traversal = Literal["bresenham", "dda"]

DEFAULT_MAX_CELLS = 100_000_000
DEFAULT_MAX_BYTES = 2 * 1024**3
DEFAULT_MAX_SCAN_CELLS = 1_000_000_000


@dataclass(frozen=True)
class GridSettings:
    """Settings of a map, checked against each other.

    `cell_model` is what a cell keeps, `sensor_model` how a scan is read: beam by beam along a `traversal`, or
    as sectors. `resolution`, `alpha` (obstacle thickness), `reach` (no beam writes farther) and `clear_range`
    (no return clears no farther) in metres; `bounds` in the map frame, None for an unbounded map, whose
    lattice has its `anchor`, m. `outside`: what happens to a beam that leaves the bounds. In a `half_life`
    (s) cells forget half of what they know (see cells.forgetting), None: nothing ever. `separate_robots`:
    what each has seen is kept by itself, and can be left out (see separate_grid). A map keeps the cells
    in its `clip` alone, and takes scans as if it had none; with a `share` the clip is that share's.
    `max_cells` limits the known rectangle, `max_bytes` what the map allocates, `max_scan_cells` what one scan
    may speak of: the cells along its beams, or, as sectors, those of its area and along its outline, within
    the bounds or not.

    Raises:
        BadSetting: a value is out of range, or the bounds do not fit the resolution, `max_cells` or the clip.
    """

    resolution: float = 0.05
    cell_model: CellModel = field(default_factory=LogOdds)
    sensor_model: SensorModel = "beam"
    traversal: Traversal = "bresenham"
    alpha: float = 0.1
    reach: float | None = None
    clear_range: float | None = None
    bounds: Region | None = None
    anchor: tuple[float, float] = (0.0, 0.0)
    outside: Outside = "clip"
    half_life: float | None = None
    clip: Clip | None = None
    separate_robots: bool = False
    share: Share | None = None
    max_cells: int = DEFAULT_MAX_CELLS
    max_bytes: int = DEFAULT_MAX_BYTES
    max_scan_cells: int = DEFAULT_MAX_SCAN_CELLS

    def __post_init__(self) -> None:
        model = _name_of(self.cell_model)
        self._check_robots(model)
        if self.share is not None:
            object.__setattr__(self, "clip", self.share.clip(self.lattice))
        self._check_distances()
        self._check_model(model)
        if self.half_life is not None:
            if not self.cell_model.ticks_a_half_life:
                raise BadSetting(f"half_life: the cells of cell model {model} do not forget: leave it out")
            tick_length(self.half_life, self.cell_model.ticks_a_half_life)
        self._check_bounds()

    def _check_distances(self) -> None:
        if not (math.isfinite(self.alpha) and self.alpha >= 0.0):
            raise BadSetting(f"alpha: 0 m or more is needed, got {self.alpha:g}")
        if self.reach is not None and not self.reach > 0.0:
            raise BadSetting(f"reach: more than 0 m is needed, got {self.reach:g}")
        if self.clear_range is not None and not self.clear_range >= 0.0:
            raise BadSetting(f"clear_range: 0 m or more is needed, got {self.clear_range:g}")

    def _check_model(self, name: str) -> None:
        """Whether the map can have cells of this model, and the model what is read of a scan."""
        model = self.cell_model
        if not 0 <= model.margin <= MAX_MARGIN:
            raise BadSetting(
                f"cell_model: {name} looks {model.margin} cells around a cell, {MAX_MARGIN} at most can be"
            )
        if any(plane.side not in {1, 2} for plane in model.planes):
            raise BadSetting(
                f"cell_model: {name} has a plane of other than 1 or 2 numbers along a cell's side"
            )
        least = MIN_RESOLUTION * model.finest
        if model.finest > 1 and self.resolution < least:
            raise BadSetting(
                f"resolution: {least:g} m or more is needed with cell model {name}, whose map is "
                f"served in cells of half that size, got {self.resolution:g}"
            )
        if self.sensor_model not in model.sensor_models:
            raise BadSetting(
                f"sensor_model: cell model {name} takes "
                f"{' or '.join(sorted(model.sensor_models))}, not {self.sensor_model}"
            )

    def _check_bounds(self) -> None:
        rect = self.bounds_rect
        if rect is None:
            return
        if rect.cells > self.max_cells:
            raise BadSetting(
                f"bounds: {rect.width} x {rect.height} cells are more than max_cells = {self.max_cells}"
            )
        if self.clip is not None and not rect.intersection(self.clip.rect).cells:
            raise BadSetting(f"clip: no cell of the bounds, {rect.width} x {rect.height}, lies in it")

    def _check_robots(self, model: str) -> None:
        """Whether robots can be kept apart, if they are to be."""
        if not self.separate_robots:
            return
        if self.share is not None:
            raise BadSetting(
                "mapper.separate_robots: a map that is cut does not keep robots apart: leave it out"
            )
        if not self.cell_model.adds_up:
            raise BadSetting(
                f"mapper.separate_robots: the cells of cell model {model} do not add up, so that no robot "
                "could be left out: give map.cell_model rate, or leave it out"
            )
        if self.half_life is not None:
            raise BadSetting(
                "mapper.separate_robots: with map.half_life cells forget whose beams they have counted: "
                "leave out one of the two"
            )

    def check_known(self, width: int, height: int) -> None:
        """Refuse a scan with which the known rectangle would have `width` x `height` cells.

        Raises:
            LimitReached: they are more than `max_cells`.
        """
        if width * height > self.max_cells:
            raise LimitReached(
                f"the map would be {width} x {height} cells, more than mapper.max_cells = {self.max_cells}: "
                f"raise it, {SMALLER_MAP}",
                "max_cells",
            )

    def check_bytes(self, nbytes: int) -> None:
        """Refuse a map that would begin with so many bytes.

        Raises:
            LimitReached: they are more than `max_bytes`.
        """
        if nbytes > self.max_bytes:
            raise LimitReached(f"{nbytes} bytes are more than max_bytes = {self.max_bytes}")

    @cached_property
    def distances(self) -> tuple[float, float, float]:
        """`alpha`, `clear_range` and `reach`, m; infinite where there is no such limit."""
        clear_range = math.inf if self.clear_range is None else float(self.clear_range)
        return float(self.alpha), clear_range, math.inf if self.reach is None else float(self.reach)

    @cached_property
    def tick(self) -> int | None:
        """How long the map's time is from one tick to the next, ns; None if its cells never forget."""
        if self.half_life is None:
            return None
        return tick_length(self.half_life, self.cell_model.ticks_a_half_life)

    @property
    def lattice(self) -> Lattice:
        """The map's lattice."""
        return self._lattice_and_rect[0]

    @property
    def finest_lattice(self) -> Lattice:
        """That of the finest cells that are served of the map."""
        return Lattice(self.resolution / self.cell_model.finest, self.lattice.anchor)

    @property
    def bounds_rect(self) -> CellRect | None:
        """The cells of the map's bounds, if it has any."""
        return self._lattice_and_rect[1]

    @property
    def clipped_bounds(self) -> CellRect | None:
        """The cells that a bounded map keeps: those of its bounds that lie in its clip."""
        rect = self.bounds_rect
        return rect if rect is None or self.clip is None else rect.intersection(self.clip.rect)

    @cached_property
    def _lattice_and_rect(self) -> tuple[Lattice, CellRect | None]:
        if self.bounds is None:
            return Lattice(self.resolution, self.anchor), None
        return bounded(self.resolution, self.bounds)


def _name_of(model: CellModel) -> str:
    """What a cell model is called in settings: log_odds, for LogOdds."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", type(model).__name__).lower()
