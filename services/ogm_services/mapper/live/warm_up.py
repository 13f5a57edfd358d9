"""Warm-up of the kernels, before anybody needs them: first what scans need, then the rest."""

import logging
import math
import threading
from contextlib import suppress
from dataclasses import replace
from typing import cast

import numpy as np

from ogm_core.cells.classes import trinary
from ogm_core.errors import LimitReached
from ogm_core.files.map_files import encode_json, encode_png
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.quality.first_walls import count_hits
from ogm_core.queries.ray_kernel import cast_rays
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.sensor_models.scan_size import ScanSize
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.separate_grid import grid_of
from ogm_core.tiles.checkpoint import Checkpoint
from ogm_core.tiles.codec import encode_tile
from ogm_core.tiles.halved import tiled
from ogm_core.tiles.pyramid import LEAST_Z, Square, TilePyramid
from ogm_core.tiles.view import TiledView
from ogm_core.types import PlacedScan, Pose, Scan, Sweep
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.runtime.compilation import compiling_until
from ogm_services.runtime.signals import MakeWay

log = logging.getLogger(__name__)


def warm_up(settings: GridSettings, threads: int = 1) -> None:
    """Load or compile every kernel for scans, the status and pictures, on a small map of the same kind.

    Also those that cut a scan into parts, where more than one of the `threads` is to update cells.
    """
    small, scan, pose = _small(settings)
    scratch = _mapped(small, scan, pose, None, threads)
    ScanSize(small).cells(scan.ranges, scan.angle_increment, scan.range_min, scan.range_max)
    hits_at_robots(small)(
        PlacedScan(scan, pose),
        np.zeros((1, 8)),
        np.zeros(scan.ranges.size),
        np.zeros(scan.ranges.size, np.bool_),
    )
    scratch.info()
    encode_png(scratch.snapshot().finest())


def warm_up_rest(settings: GridSettings, threads: int = 1) -> None:
    """The same for what can wait: storing, quality, other formats, tiles, sweeps, a map that is full."""
    small, scan, pose = _small(settings)
    scratch = _mapped(small, scan, pose, Sweep(pose, np.array([pose, pose], np.float64)), threads)
    for tile in cast(Checkpoint, scratch.checkpoint()).tiles_since(0):
        encode_tile(tile.planes)
    scratch.quality()
    whole = scratch.snapshot().finest()
    count_hits(whole, PlacedScan(scan, pose), small, 1)
    start, ahead = whole.lattice.in_cells(np.array(pose[:2])).tolist(), np.array([[1.0, 0.0]])
    cast_rays((start[0], start[1]), ahead, 1.0, False, whole.offset, whole.encode(trinary))
    encode_json(whole, "", "percent")
    TilePyramid().pixels(cast(TiledView, tiled(whole.stored)), whole.model, Square(LEAST_Z, 0, -1))
    with suppress(LimitReached):  # a map that is full counts tiles by another kernel
        grid_of(replace(small, max_bytes=1)).integrate(scan, pose)


def _mapped(small: GridSettings, scan: Scan, pose: Pose, sweep: Sweep | None, threads: int) -> LiveMap:
    """A map of a scan, which goes all ways that scans go into a map: two of one thread, and shared ones."""
    scratch = LiveMap(grid_of(small))
    for _ in range(2):  # kernels of a scan that tells of new cells, and of one that does not
        scratch.integrate(scan, pose, sweep)
    if threads > 1:
        with UpdateThreads(threads, least_cells=1) as helping:
            shared = LiveMap(grid_of(small), threads=helping)
            for _ in range(3):  # in parts, then found to be worth a team, then by one
                shared.integrate(scan, pose, sweep)
    return scratch


class RestOfWarmUp:
    """`warm_up_rest` on a thread of its own: nobody waits for it. Started at most once, stopped once."""

    def __init__(self, settings: GridSettings, threads: int = 1) -> None:
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(settings, threads), name="ogm-warm-up")

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def make_way(self) -> None:
        """Let it end: a kernel that is being compiled is given up, after its pass."""
        self._stopping.set()

    def stop(self) -> None:
        """End it, and wait for that."""
        self.make_way()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self, settings: GridSettings, threads: int) -> None:
        try:
            with suppress(MakeWay), compiling_until(self._stopping.is_set):
                warm_up_rest(settings, threads)
        except Exception:
            # A bug of ours: its traceback is kept, and whoever needs these kernels compiles them.
            log.exception("not every kernel could be made ready")


def _small(settings: GridSettings) -> tuple[GridSettings, Scan, Pose]:
    """Settings of a small map of the same kind, and a scan in its middle: a hit, and no return."""
    side = 64.0 * settings.resolution
    small = GridSettings(
        settings.resolution,
        settings.cell_model,
        settings.sensor_model,
        settings.traversal,
        bounds=None if settings.bounds is None else Region(0.0, 0.0, side, side),
        outside=settings.outside,
        separate_robots=settings.separate_robots,
    )
    scan = Scan(0, 0.0, 1.0, 0.0, side / 3, np.array([side / 4, math.inf], np.float32))
    return small, scan, Pose(side / 2, side / 2, 0.0)
