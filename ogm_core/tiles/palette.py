"""Palette of a tile: the few different numbers in it, and for every cell which of them it is.

Log odds are sums of two increments between clamps, so a map has some hundred different ones, and a tile few
dozens: one byte a cell says which. A number is told by its bits, so it comes back as it was.
"""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

MAX_NUMBERS = 256
_SLOTS = 1024
"""Of a hash table with linear probing; a power of two."""
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)
_SHIFT = np.uint64(64 - 10)


@njit(cache=True, nogil=True, error_model="numpy")
def find_palette(bits: NDArray[Any], numbers: NDArray[Any], index: NDArray[np.uint8]) -> int:
    """Write the different numbers of `bits`, unsigned, into `numbers`, in order of appearance.

    And into `index`, of the shape of `bits`, which of them each is. Returns how many they are; 0 if they are
    more than MAX_NUMBERS, the length of `numbers`.
    """
    slots = np.zeros(_SLOTS, np.int16)
    count, last = 0, 0
    for k in range(len(bits)):
        number = bits[k]
        if count and number == numbers[last]:  # cells beside each other are often alike
            index[k] = last
            continue
        slot = (np.uint64(number) * _MULTIPLIER) >> _SHIFT
        while slots[slot] and numbers[slots[slot] - 1] != number:
            slot = (slot + np.uint64(1)) & np.uint64(_SLOTS - 1)
        if not slots[slot]:
            if count == MAX_NUMBERS:
                return 0
            numbers[count] = number
            count += 1
            slots[slot] = count
        last = slots[slot] - 1
        index[k] = last
    return count
