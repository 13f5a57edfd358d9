"""Before a mapper is ready every kernel is compiled, whatever the settings; no scan waits for a compiler."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import LimitReached
from ogm_core.files.map_files import PALETTES, encode_png
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.quality import agreement
from ogm_core.sensor_models import area_fill, area_outline, beams, bresenham, dda, spans
from ogm_core.tiles import view as tiled_cells
from ogm_core.types import Pose, Scan
from ogm_core.wire.messages import decode_scan, encode_scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.service import OccupancyGrid, warm_up

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
    tiled_cells._count_written,
    tiled_cells._lay_out,
    tiled_cells._count_values,
)


def compiled():
    return [len(kernel.signatures) for kernel in KERNELS]


@pytest.mark.parametrize("outside", ["clip", "drop"])
@pytest.mark.parametrize("cells", ["int16", "float64"])
@pytest.mark.parametrize("bounds", [None, Region(-3, -2, 3, 2)])
@pytest.mark.parametrize(("sensor", "traversal"), [("beam", "bresenham"), ("beam", "dda"), ("sector", "dda")])
def test_afterwards_nothing_is_compiled(sensor, traversal, bounds, cells, outside):
    settings = GridSettings(0.1, LogOdds(cells), sensor, traversal, bounds=bounds, outside=outside)
    warm_up(settings)
    before = compiled()
    live_map = LiveMap(OccupancyGrid(settings))
    ranges = np.array([1.0, 7.9, math.inf, math.nan], np.float32)
    scan = decode_scan(encode_scan(Scan(0, 0.0, 0.1, 0.0, 8.0, ranges)))
    live_map.integrate(scan, Pose(0, 0, 0))
    # One beam, or nothing seen: arrays of a single column, or of none, have another memory layout to numba.
    for odd in ([1.0], [math.nan], [math.nan, math.nan], [1.0, math.nan, 2.0]):
        live_map.integrate(Scan(0, 0.0, 0.1, 0.0, 8.0, np.array(odd, np.float32)), Pose(0, 0, 0))
        live_map.integrate(Scan(0, 0.0, 1.9, 0.0, 8.0, np.array(odd, np.float32)), Pose(0, 0, 0))
        live_map.snapshot().crop(Region(0.0, 0.0, 1.0, 1.0))
        for palette in PALETTES:
            encode_png(live_map.snapshot(), palette)
    live_map.info()
    live_map.quality()
    with pytest.raises(LimitReached):
        OccupancyGrid(replace(settings, max_bytes=1)).integrate(scan, Pose(0.0, 0.04, 0.0))
    assert compiled() == before


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
