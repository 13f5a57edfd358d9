"""What everything outside a cell model knows of one."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

StoredCells = NDArray[Any]
"""Cells as a model stores them, any shape; a stored 0 was never updated."""
Encoder = Callable[[NDArray[np.float64], NDArray[np.bool_]], NDArray[Any]]
"""From (probability, known) of cells to what is served of them, element by element."""
