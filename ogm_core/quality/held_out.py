"""Figures of a map by scans that were held out of it, as quality.json has them."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import row_bands
from ogm_core.grid_settings import GridSettings
from ogm_core.quality import agreement
from ogm_core.quality.judgement import judge
from ogm_core.queries.rays import FOUND_UNKNOWN, FOUND_WALL
from ogm_core.sensor_models.projection import beam_model, read_only, sensor_poses
from ogm_core.snapshot import MapSnapshot
from ogm_core.types import PlacedScan

JUDGED_SHORTER_THAN = 15.0
CAST_UP_TO = 25.0
DECIDED = 0.6
"""A cell counts as a wall, or as free, if its log odds differ from the prior's by more than this."""


def held_out(snapshot: MapSnapshot, settings: GridSettings, scans: Sequence[PlacedScan]) -> dict[str, Any]:
    """How well the map predicts scans that are not in it: `predicted_walls`, and two figures of `judge`."""
    judgement = judge(snapshot, settings, scans)
    return {
        **predicted_walls(snapshot, settings, scans),
        "bits": judgement.bits,
        "hit": judgement.walls.hit,
    }


def predicted_walls(
    snapshot: MapSnapshot, settings: GridSettings, scans: Iterable[PlacedScan]
) -> dict[str, Any]:
    """How well the map predicts scans that are not in it.

    Judged are their hits shorter than 15 m; each is cast up to 25 m through the map and ends where it enters
    the first cell with l - l0 > 0.6, or in the unknown if a cell that is not clearly free comes first. Shares
    are of all judged beams, the median error is of those that found a wall.
    """
    beliefs = _decided(snapshot)
    parts = [_predict(snapshot, settings, beliefs, placed) for placed in scans]
    measured, found, predicted = np.concatenate([np.empty((3, 0)), *parts], axis=1)
    error = np.abs(predicted - measured)
    walls = found == FOUND_WALL
    judged = measured.size

    def share(beams: NDArray[np.bool_]) -> float | None:
        return float(np.count_nonzero(beams)) / judged if judged else None

    return {
        "beams": judged,
        "median_abs_m": float(np.median(error[walls])) if walls.any() else None,
        "within_0_1_m": share(walls & (error <= 0.1)),
        "within_0_2_m": share(walls & (error <= 0.2)),
        "into_unknown": share(found == FOUND_UNKNOWN),
    }


def _decided(snapshot: MapSnapshot) -> NDArray[np.uint8]:
    beliefs = np.full((snapshot.height, snapshot.width), agreement.BELIEF_UNDECIDED, np.uint8)
    for band in row_bands(beliefs.shape):
        evidence = snapshot.log_odds(band) - snapshot.model.l0
        beliefs[band][evidence > DECIDED] = agreement.BELIEF_OCCUPIED
        beliefs[band][evidence < -DECIDED] = agreement.BELIEF_FREE
    return beliefs


def _predict(
    snapshot: MapSnapshot, settings: GridSettings, beliefs: NDArray[np.uint8], placed: PlacedScan
) -> NDArray[np.float64]:
    resolution = snapshot.lattice.resolution
    sensor = sensor_poses(placed).copy()
    sensor[:, :2] = snapshot.lattice.in_cells(sensor[:, :2]) - snapshot.offset
    judged: NDArray[np.float64] = agreement.predict_ranges(
        read_only(placed.scan.ranges),
        beam_model(placed.scan, settings),
        sensor,
        float(resolution),
        JUDGED_SHORTER_THAN,
        CAST_UP_TO,
        beliefs,
    )
    return judged
