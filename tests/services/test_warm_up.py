"""Kernels are compiled before anybody needs them, whatever the settings; no scan waits for a compiler."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numba import njit

from ogm_core.cells import rate_kernel
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import LimitReached
from ogm_core.files.map_files import PALETTES, encode_json, encode_npz, encode_pgm, encode_png
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.quality import agreement, first_walls, held_out_beams
from ogm_core.queries import ray_kernel
from ogm_core.sensor_models import (
    area_fill,
    area_outline,
    beams,
    bresenham,
    counted_beams,
    dda,
    one_call_kernels,
    passing,
    shared_lines,
    spans,
    strip_work,
)
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.tiles import overviews
from ogm_core.tiles import view as tiled_cells
from ogm_core.tiles.pyramid import Square
from ogm_core.types import Pose, Scan, Sweep
from ogm_core.wire.messages import decode_scan, encode_scan
from ogm_services.mapper.live import warm_up as warm_up_module
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.warm_up import RestOfWarmUp, warm_up, warm_up_rest
from ogm_services.mapper.serving.map_tiles import MapTiles
from ogm_services.mapper.serving.raycasts import Fan, FanCells

ROOT = Path(__file__).parents[2]
TIMEOUT = 240.0

KERNELS = (
    beams.project,
    beams.project_turned,
    beams.drop_outside,
    bresenham.extent,
    bresenham.touch_tiles,
    bresenham.update_cells,
    dda.extent,
    dda.touch_tiles,
    dda.update_cells,
    area_outline.turned,
    area_fill.see,
    area_fill.spans,
    spans.extent,
    spans.touch_tiles,
    spans.update_blocks,
    spans.update_one_by_one,
    agreement.agreement,
    one_call_kernels.add_lines,
    one_call_kernels.count_beams,
    one_call_kernels.fill_area,
    held_out_beams.collect_returns,
    first_walls.count_early_walls,
    ray_kernel.cast_rays,
    tiled_cells._count_written,
    tiled_cells._lay_out,
    tiled_cells._count_values,
    overviews.look_up,
    overviews.make_overviews,
    overviews.put_together,
)


LATER = (
    beams.project,
    bresenham.touch_tiles,
    dda.touch_tiles,
    spans.touch_tiles,
    agreement.agreement,
    ray_kernel.cast_rays,
    tiled_cells._count_values,
    overviews.look_up,
    overviews.make_overviews,
    overviews.put_together,
)
"""Kernels that no scan waits for, unless it is its sensor's first sweep or the map is full."""


def compiled(kernels=KERNELS):
    return [len(kernel.signatures) for kernel in kernels]


def every_kind_of_settings(test):
    for marks in (
        pytest.mark.parametrize("outside", ["clip", "drop"]),
        pytest.mark.parametrize("cells", ["int16", "float64"]),
        pytest.mark.parametrize("bounds", [None, Region(-3, -2, 3, 2)]),
        pytest.mark.parametrize(
            ("sensor", "traversal"), [("beam", "bresenham"), ("beam", "dda"), ("sector", "dda")]
        ),
    ):
        test = marks(test)
    return test


def scans():
    """What sensors send: one beam, or nothing seen, makes arrays of another memory layout to numba."""
    ranges = np.array([1.0, 7.9, math.inf, math.nan], np.float32)
    yield decode_scan(encode_scan(Scan(0, 0.0, 0.1, 0.0, 8.0, ranges)))
    for odd in ([1.0], [math.nan], [math.nan, math.nan], [1.0, math.nan, 2.0]):
        yield Scan(0, 0.0, 0.1, 0.0, 8.0, np.array(odd, np.float32))
        yield Scan(0, 0.0, 1.9, 0.0, 8.0, np.array(odd, np.float32))


def map_and_look_at_it(settings):
    live_map = LiveMap(OccupancyGrid(settings))
    for scan in scans():
        live_map.integrate(scan, Pose(0, 0, 0))
        for palette in PALETTES:
            encode_png(live_map.snapshot(), palette)
        live_map.info()


@every_kind_of_settings
def test_once_ready_no_scan_and_no_look_at_the_live_map_waits_for_a_compiler(
    sensor, traversal, bounds, cells, outside
):
    settings = GridSettings(0.1, LogOdds(cells), sensor, traversal, bounds=bounds, outside=outside)
    warm_up(settings)
    before = compiled()
    map_and_look_at_it(settings)
    assert compiled() == before


@every_kind_of_settings
def test_afterwards_nothing_is_compiled(sensor, traversal, bounds, cells, outside):
    settings = GridSettings(0.1, LogOdds(cells), sensor, traversal, bounds=bounds, outside=outside)
    warm_up(settings)
    warm_up_rest(settings)
    before = compiled()
    live_map = LiveMap(OccupancyGrid(settings))
    tiles = MapTiles(live_map)
    for scan in scans():
        poses = np.zeros((scan.ranges.size, 3))
        live_map.integrate(scan, Pose(0, 0, 0))
        live_map.integrate(scan, Pose(0, 0, 0), Sweep(Pose(0, 0, 0), poses))
        snapshot = live_map.snapshot()
        snapshot.crop(Region(0.0, 0.0, 1.0, 1.0))
        for encode in (encode_png, encode_pgm):
            for palette in PALETTES:
                encode(snapshot, palette)
        encode_json(snapshot, "")
        encode_npz(snapshot)
        for z in range(10, 17):
            tiles.tile(Square(z, 0, -1), "ros")
    live_map.info()
    live_map.quality()
    Fan((0.0, 0.0), [0.0, 1.0], 2.0, through_unknown=True).cast(
        FanCells.of(Fan((0.0, 0.0), [0.0], 2.0, False), snapshot)
    )
    with pytest.raises(LimitReached):
        OccupancyGrid(replace(settings, max_bytes=1)).integrate(scan, Pose(0.0, 0.04, 0.0))
    assert compiled() == before


def test_what_can_wait_is_not_compiled_before_the_first_scan():
    program = (
        "from tests.services.test_warm_up import *\n"
        "settings = GridSettings()\n"
        "warm_up(settings); before = compiled()\n"
        "map_and_look_at_it(settings); assert compiled() == before != [0] * len(KERNELS)\n"
        "print(sum(compiled(LATER)))\n"
        "warm_up_rest(settings); print(sum(compiled(LATER)))\n"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=TIMEOUT
    )
    first, later = map(int, printed.stdout.split())
    assert first == 0 < later


def test_the_rest_can_be_given_up_between_two_passes_of_the_compiler(eventually, monkeypatch):
    passes = []

    def compile_without_end(*_):
        while True:
            passes.append(0)
            njit(lambda x: x + 1)(1)

    monkeypatch.setattr(warm_up_module, "warm_up_rest", compile_without_end)
    rest = RestOfWarmUp(GridSettings())
    rest.start()
    eventually(lambda: len(passes) > 1, TIMEOUT)
    rest.stop()
    assert not rest._thread.is_alive()


@pytest.mark.parametrize(
    "settings",
    [
        GridSettings(bounds=Region(0, 0, 0.2, 0.2), outside="drop"),
        GridSettings(bounds=Region(0, 0, 600, 500), max_cells=2 * 10**8),
        GridSettings(alpha=1e6),
        GridSettings(reach=1e-3, clear_range=0.0, max_bytes=1, max_cells=1),
        GridSettings(resolution=0.001, cell_model=LogOdds(p_free=0.499)),
        GridSettings(resolution=1e6),
        GridSettings(sensor_model="sector", alpha=0.0),
    ],
    ids=lambda settings: f"{settings.resolution:g} m, {settings.bounds}, alpha {settings.alpha:g}",
)
def test_any_sound_settings_warm_up(settings):
    warm_up(settings)
    warm_up_rest(settings)


OF_COUNTS = (
    counted_beams.weigh,
    passing.extent,
    passing.touch_tiles,
    passing.update_planes,
    rate_kernel._publish,
    overviews.write_value_bytes,
)


@pytest.mark.parametrize("outside", ["clip", "drop"])
@pytest.mark.parametrize("bounds", [None, Region(-3, -2, 3, 2)])
def test_of_a_map_that_counts_nothing_is_compiled_afterwards(bounds, outside):
    settings = GridSettings(0.1, Rate(), bounds=bounds, outside=outside)
    warm_up(settings)
    before = compiled(OF_COUNTS)
    live_map = LiveMap(OccupancyGrid(settings))
    for scan in scans():
        live_map.integrate(scan, Pose(0, 0, 0))
        encode_png(live_map.snapshot().finest())
        live_map.info()
    assert compiled(OF_COUNTS) == before
    warm_up_rest(settings)
    before = compiled(KERNELS + OF_COUNTS)
    tiles = MapTiles(live_map)
    for scan in scans():
        live_map.integrate(scan, Pose(0, 0, 0), Sweep(Pose(0, 0, 0), np.zeros((scan.ranges.size, 3))))
        for snapshot in (live_map.snapshot(), live_map.snapshot().finest()):
            encode_npz(snapshot)
            encode_pgm(snapshot)
        for z in range(10, 17):
            tiles.tile(Square(z, 0, -1), "ros")
        live_map.quality()
    assert compiled(KERNELS + OF_COUNTS) == before
    assert min(compiled(OF_COUNTS)) >= 1


def integrate_small_and_shared(settings, *, swept=False):
    """Scans that are too small to be shared, and scans that are."""
    for least in (10**9, 1):
        with UpdateThreads(2, least_cells=least) as threads:
            live_map = LiveMap(OccupancyGrid(settings), threads=threads)
            for scan in scans():
                sweep = Sweep(Pose(0, 0, 0), np.zeros((scan.ranges.size, 3))) if swept else None
                for _ in range(3):
                    live_map.integrate(scan, Pose(0, 0, 0), sweep)


@pytest.mark.parametrize(
    "settings",
    [
        GridSettings(0.1),
        GridSettings(0.1, LogOdds("float64"), traversal="dda"),
        GridSettings(0.1, sensor_model="sector"),
        GridSettings(0.1, Rate()),
    ],
    ids=["bresenham", "dda float64", "sector", "rate"],
)
def test_scans_that_several_threads_share_wait_for_no_compiler(settings):
    warm_up(settings, threads=2)
    kernels = (
        *KERNELS,
        *OF_COUNTS,
        strip_work.work_of_beams,
        strip_work.work_of_spans,
        strip_work.even_cuts,
        shared_lines.serve,
        shared_lines.update_cells,
    )
    before = compiled(kernels)
    integrate_small_and_shared(settings)
    assert compiled(kernels) == before
    assert len(strip_work.even_cuts.signatures) == 1
    warm_up_rest(settings, threads=2)
    before = compiled(kernels)
    integrate_small_and_shared(settings, swept=True)
    assert compiled(kernels) == before
