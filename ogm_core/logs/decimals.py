"""Ranges out of a CARMEN log's text, a whole sweep at once, where they are plain decimals; it loads numba.

A plain decimal is `-`, digits, `.`, digits: no exponent, no `+`, no leading zero, a digit on either side of
the point. Its digits are a whole number m below 2^53 and its value m / 10^k with k <= 22, both of which are
exact in float64, so that one division gives the very number that Python reads (Clinger 1990, section 3). All
else is left to whoever reads with care.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ogm_core.types import Ranges

_EXACT = 2**53
_MAX_PLACES = 22
_POWERS_OF_TEN = 10.0 ** np.arange(_MAX_PLACES + 1)
_SPACE, _TAB, _MINUS, _POINT, _ZERO = b" \t-.0"


def read_decimals(text: bytes, count: int) -> tuple[Ranges, int] | None:
    """The `count` plain decimals, between blanks, that `text` begins with: float32, and where the last ends.

    None if there are fewer, or one of them is not plain.
    """
    ranges = np.empty(count, np.float32)
    end = _read(np.frombuffer(text, np.uint8), ranges)
    if end < 0:
        return None
    ranges.flags.writeable = False
    return ranges, end


@njit(cache=True, nogil=True, error_model="numpy")
def _read(text: NDArray[np.uint8], numbers: Ranges) -> int:
    """Fill `numbers`; return the place after the last one, or -1 if it is not to be read here."""
    at = 0
    for n in range(numbers.size):
        begin = at
        at = _after_blanks(text, at)
        if n and at == begin:
            return -1
        number, at = _decimal(text, at)
        if at < 0:
            return -1
        numbers[n] = number
    return at


@njit(cache=True, nogil=True, error_model="numpy")
def _after_blanks(text: NDArray[np.uint8], at: int) -> int:
    while at < text.size and (text[at] == _SPACE or text[at] == _TAB):
        at += 1
    return at


@njit(cache=True, nogil=True, error_model="numpy")
def _decimal(text: NDArray[np.uint8], at: int) -> tuple[float, int]:
    """The plain decimal at a place, and the place after it, -1 if there is none."""
    negative = at < text.size and text[at] == _MINUS
    at += negative
    first = at
    digits = 0
    places = -1  # behind the point; -1 before there is one
    while at < text.size:
        digit = int(np.int64(text[at]) - _ZERO)
        if 0 <= digit <= 9:
            digits = 10 * digits + digit
            if digits >= _EXACT:
                return 0.0, -1
            places += places >= 0
        elif text[at] == _POINT and places < 0 and at > first:
            places = 0
        else:
            break
        at += 1
    leading_zero = at > first + 1 and text[first] == _ZERO and text[first + 1] != _POINT
    if at == first or leading_zero or places == 0 or places > _MAX_PLACES or (negative and digits == 0):
        return 0.0, -1  # the sign of "-0" would be lost
    number = digits / _POWERS_OF_TEN[max(places, 0)]
    return -number if negative else number, at
