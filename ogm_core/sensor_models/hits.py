"""Hits of a placed scan near given places in the map frame: beams that ended on what stood there."""

from collections.abc import Callable

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.grid_settings import GridSettings
from ogm_core.sensor_models.beams import BeamModel, Plain, end_point, reading
from ogm_core.sensor_models.projection import beam_model, read_only, sensor_poses
from ogm_core.types import PlacedScan


def hits_near_by(
    settings: GridSettings,
) -> Callable[[PlacedScan, NDArray[np.float64], NDArray[np.bool_]], None]:
    """What marks the hits, as a map of these settings reads a scan, that end at given places.

    It takes a placed scan, the places and the marks, as `ogm_core.placing.other_robots.MarkHits` says.
    """

    def mark(placed: PlacedScan, places: NDArray[np.float64], near: NDArray[np.bool_]) -> None:
        model = tuple(beam_model(placed.scan, settings))
        _mark(read_only(placed.scan.ranges), model, sensor_poses(placed), places, near)

    return mark


@njit(cache=True, error_model="numpy")
def _mark(
    ranges: NDArray[np.float32],
    beam: Plain,
    sensor: NDArray[np.float64],
    places: NDArray[np.float64],
    near: NDArray[np.bool_],
) -> None:
    """Mark in `near`, shape (N,), the hits that end within the radius of one of their places.

    `places` holds x, y and radius, m: shape (1, P, 3), or (N, P, 3) with those of each beam. `sensor` as in
    `beams.project`; `beam` are the contents of a BeamModel.
    """
    model = BeamModel(*beam)
    for k in range(ranges.size):
        _, hit, length = reading(float(ranges[k]), model)
        if not hit:
            continue
        s = k if len(sensor) > 1 else 0
        x, y = end_point(k, length, sensor[s, 0], sensor[s, 1], sensor[s, 2], model)
        b = k if len(places) > 1 else 0
        for p in range(places.shape[1]):
            dx, dy, radius = x - places[b, p, 0], y - places[b, p, 1], places[b, p, 2]
            if dx * dx + dy * dy <= radius * radius:
                near[k] = True
                break
