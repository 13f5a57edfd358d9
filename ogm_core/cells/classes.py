"""Cell classes and palettes: what is served of (probability, known), element by element.

Every encoder here is a `model.Encoder`: hand it to `MapSnapshot.encode`, or call it with two
arrays of one shape, and with the map's `free_below` if it has one of its own.
"""

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Known, Probability
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE

OCCUPIED = 100
FREE = 0
UNKNOWN = -1
"""Values of a trinary cell, those of ROS's nav_msgs/OccupancyGrid; UNKNOWN is also "undecided"."""

GREY_OCCUPIED = 0
GREY_FREE = 254
GREY_UNKNOWN = 205
"""Greys that ROS 2 nav2 map_server writes: (255 - 205) / 255 = 0.19608 lies just above its 0.196."""
GREY_MIDDLE = 127
"""Unknown in a probability picture."""


def trinary(p: Probability, known: Known, free_below: float = FREE_BELOW) -> NDArray[np.int8]:
    """100 where occupied (p > 0.65), 0 where free (p < free_below), -1 where undecided or unknown."""
    return _three(p, known, free_below, (OCCUPIED, FREE, UNKNOWN)).astype(np.int8)


def ros_grey(p: Probability, known: Known, free_below: float = FREE_BELOW) -> NDArray[np.uint8]:
    """0 where occupied (p > 0.65), 254 where free (p < free_below), 205 where undecided or unknown."""
    return _three(p, known, free_below, (GREY_OCCUPIED, GREY_FREE, GREY_UNKNOWN)).astype(np.uint8)


def probability_grey(p: Probability, known: Known, _free_below: float = FREE_BELOW) -> NDArray[np.uint8]:
    """floor(255 p + 0.5), brighter is more likely occupied; 127 where unknown."""
    return np.where(known, np.floor(255.0 * p + 0.5), GREY_MIDDLE).astype(np.uint8)


def percent(p: Probability, known: Known, _free_below: float = FREE_BELOW) -> NDArray[np.int8]:
    """floor(100 p + 0.5), or -1 where unknown."""
    return np.where(known, np.floor(100.0 * p + 0.5), UNKNOWN).astype(np.int8)


def _three(p: Probability, known: Known, free_below: float, values: tuple[int, int, int]) -> NDArray[np.int_]:
    occupied, free, neither = values
    return np.where(known & (p > OCCUPIED_ABOVE), occupied, np.where(known & (p < free_below), free, neither))
