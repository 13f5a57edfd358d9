"""Value bytes: a cell's probability in one byte, and the palettes that draw it.

    0           1 ... 50     51 ... 166     167 ... 255
    unknown     free         undecided      occupied

Classes are exact, and p is about (byte - 1) / 254: off by 0.0036 at most. In a map with a `free_below` of its
own, what lies between that and 0.196 is off by more: it has the nearest byte of its class. The byte rises
with p, so that blocks of cells can be joined by their bytes (tiles.overviews), and a palette is a colour for
each byte.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import (
    GREY_FREE,
    GREY_MIDDLE,
    GREY_OCCUPIED,
    GREY_UNKNOWN,
    percent,
    probability_grey,
)
from ogm_core.cells.model import Known, Probability
from ogm_core.cells.thresholds import FREE_BELOW, OCCUPIED_ABOVE

UNKNOWN_BYTE = 0
FREE_LAST = 50
OCCUPIED_FIRST = 167
LEVELS = 254.0

Colours = NDArray[np.uint8]
"""Red, green and blue of every value byte, shape (256, 3)."""
Colour = tuple[int, int, int]

_CIVIDIS = np.array(
    (
        *((0, 0, 34, 78), (20, 0, 47, 111), (32, 26, 56, 111), (64, 67, 78, 108), (96, 97, 101, 111)),
        *((128, 125, 124, 120), (159, 154, 147, 118), (191, 187, 173, 109), (223, 221, 200, 88)),
        (255, 254, 232, 56),
    )
)
"""Some of the 256 colours of cividis (Nunez, Anderton & Renslow 2018), each behind its number.

Their lightness rises evenly, and who sees red and green alike sees them as others do.
"""


def value_byte(p: Probability, known: Known, free_below: float = FREE_BELOW) -> NDArray[np.uint8]:
    """1 + floor(254 p + 0.5), kept within the bytes of the cell's class; 0 where unknown."""
    byte = np.floor(LEVELS * p + 1.5)
    in_class = np.where(
        p > OCCUPIED_ABOVE,
        np.maximum(byte, OCCUPIED_FIRST),
        np.where(
            p < free_below, np.minimum(byte, FREE_LAST), np.clip(byte, FREE_LAST + 1, OCCUPIED_FIRST - 1)
        ),
    )
    return np.where(known, in_class, UNKNOWN_BYTE).astype(np.uint8)


def _flat(occupied: Colour, free: Colour, undecided: Colour, unknown: Colour) -> Colours:
    colours = np.empty((256, 3), np.uint8)
    colours[UNKNOWN_BYTE] = unknown
    colours[1 : FREE_LAST + 1] = free
    colours[FREE_LAST + 1 : OCCUPIED_FIRST] = undecided
    colours[OCCUPIED_FIRST:] = occupied
    return colours


def _grey(grey: int) -> Colour:
    return grey, grey, grey


def _probability() -> Colours:
    greys = probability_grey(_P, _KNOWN)
    greys[UNKNOWN_BYTE] = GREY_MIDDLE
    return np.repeat(greys[:, None], 3, axis=1)


def _cividis() -> Colours:
    channels = [np.interp(255.0 * _P, _CIVIDIS[:, 0], _CIVIDIS[:, channel]) for channel in (1, 2, 3)]
    colours = np.floor(np.stack(channels, axis=1) + 0.5).astype(np.uint8)
    colours[UNKNOWN_BYTE] = _grey(236)
    return colours


def _costmap() -> Colours:
    """RViz's colours of an OccupancyGrid in its scheme "costmap", by the cell's percent.

    A cost of 0, through which RViz lets its ground shine, has the colour of that ground: it is not unknown.
    """
    cost = percent(_P, _KNOWN).astype(np.int64)
    red = 255 * cost // 100
    colours = np.stack((red, np.zeros_like(red), 255 - red), axis=1).astype(np.uint8)
    colours[cost == 0] = _grey(48)
    colours[cost == 99] = 0, 255, 255
    colours[cost == 100] = 255, 0, 255
    colours[UNKNOWN_BYTE] = 0x70, 0x89, 0x86
    return colours


_P = np.clip((np.arange(256) - 1) / LEVELS, 0.0, 1.0)
_KNOWN = np.arange(256) != UNKNOWN_BYTE

COLOURS: Mapping[str, Colours] = MappingProxyType(
    {
        "ros": _flat(_grey(GREY_OCCUPIED), _grey(GREY_FREE), _grey(GREY_UNKNOWN), _grey(GREY_UNKNOWN)),
        "probability": _probability(),
        "cividis": _cividis(),
        "dark": _flat((0xEB, 0xEB, 0xEB), (0x3A, 0x3A, 0x3A), (0x28, 0x28, 0x28), (0x1B, 0x1E, 0x22)),
        "costmap": _costmap(),
    }
)
"""Palettes by name: the first two are those of grey pictures (classes.ros_grey, classes.probability_grey)."""
for _colours in COLOURS.values():
    _colours.flags.writeable = False


def legend(palette: str) -> dict[str, str]:
    """What a palette's colours stand for, as #rrggbb: certainly occupied, certainly free, even; unknown."""
    colours = COLOURS[palette]
    bytes_of = {"occupied": 255, "free": 1, "undecided": 128, "unknown": UNKNOWN_BYTE}
    return {name: "#" + colours[byte].tobytes().hex() for name, byte in bytes_of.items()}
