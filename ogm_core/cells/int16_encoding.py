"""What an elementwise encoder makes of int16 cells: there are 65,536 of them, and each is encoded once."""

from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.model import Encoder, StoredCells

_MOST_STEPS = 4


class Int16Model(Protocol):
    """What int16 cells of one plane mean; equal models say the same."""

    def __hash__(self) -> int:
        """What is worked out of a model is kept by it."""

    @property
    def free_below(self) -> float:
        """Below which probability known cells count as free."""

    def known(self, cells: StoredCells) -> NDArray[np.bool_]:
        """Which cells were ever updated."""

    def probability(self, cells: StoredCells) -> NDArray[np.float64]:
        """Probability of "occupied", the prior's where unknown."""


@lru_cache(maxsize=16)
def encoded_values(model: Int16Model, encoder: Encoder) -> NDArray[Any]:
    """What `encoder` makes of every int16 cell, shape (65536,), indexed by the cell's bits."""
    every = np.arange(2**16, dtype=np.uint16).view(np.int16)
    return encoder(model.probability(every), model.known(every), model.free_below)


@lru_cache(maxsize=16)
def steps_of(model: Int16Model, encoder: Encoder) -> tuple[tuple[int, int], ...]:
    """Stored int16 values, rising, from which on an encoder gives another byte: by how much more, modulo 256.

    The first one is the lowest value, and its byte. None of what is not a byte, or steps too often.
    """
    table = np.roll(encoded_values(model, encoder), 2**15)  # by the cell's value, from the lowest
    if table.itemsize != 1:
        return ()
    bytes_of = table.view(np.uint8)
    places = np.flatnonzero(np.diff(bytes_of)) + 1
    if len(places) > _MOST_STEPS:
        return ()
    more = bytes_of[places] - bytes_of[places - 1]
    rest = zip((places - 2**15).tolist(), more.tolist(), strict=True)
    return ((-(2**15), int(bytes_of[0])), *rest)


def encode_by_steps(
    cells: StoredCells, steps: tuple[tuple[int, int], ...], encoded: NDArray[np.uint8]
) -> None:
    """Write what `steps_of` says of int16 cells: a comparison of many at once each; a table is slower."""
    encoded[:] = steps[0][1]
    for value, more in steps[1:]:
        encoded += (cells >= value).view(np.uint8) * np.uint8(more)
