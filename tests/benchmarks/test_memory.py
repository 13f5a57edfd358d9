"""What a map of counts takes of memory along walls."""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

from benchmarks.memory import DEADLINE, PAGE, pages, walled


@pytest.mark.skipif(sys.platform != "linux", reason="the system tells what a process has of its memory")
def test_the_walls_of_the_lab_are_as_long_as_they_are():
    """Four circles, of 4.7 m radius together, inside walls of 80 m."""
    walled("lab")  # compiles here, which leaves memory that a process made for it would take again
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        walls = process.submit(walled, "lab").result(DEADLINE)
    assert walls.metres == pytest.approx(80.0 + 2 * np.pi * 4.7, rel=0.1)
    assert 100 * PAGE < walls.halves < walls.private + 100 * PAGE
    assert walls.halves % PAGE == 0
    assert walls.cells == pytest.approx(40_000, rel=0.05)


def test_pages_are_those_with_a_number():
    cells = np.zeros(5 * PAGE // 4, np.uint32)
    cells[[0, 1, PAGE // 4, 5 * PAGE // 4 - 1]] = 1
    assert pages(cells) == 3
