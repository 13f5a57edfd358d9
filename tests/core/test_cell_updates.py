"""What kernels do to single cells is what plain Python does to them."""

import numpy as np
import pytest
from numba import njit

from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.updates import ended, passed

MODELS = {
    "usual": LogOdds(),
    "clamps that rounding brings to the prior": LogOdds(p_prior=0.3, p_free=0.2, l_min=-0.8474, l_max=8.0),
    "a pass lowers by more than int16 holds": LogOdds(p_free=0.0, p_prior=0.5, l_min=-2.0, l_max=2.0),
    "narrow clamps": LogOdds(p_free=0.0, p_occ=1.0, l_min=-0.5, l_max=0.25),
}


@njit
def _all_passed(cells, constants):
    for k in range(cells.size):
        cells[k] = passed(cells[k], 1.0, constants)


@pytest.mark.parametrize("name", MODELS)
def test_a_pass_lowers_every_int16_cell_as_plain_python_does(name):
    constants = MODELS[name].constants
    every = np.arange(-(2**15), 2**15).astype(np.int16)
    got = every.copy()
    _all_passed(got, tuple(constants))
    exact = np.maximum(every.astype(np.int64) + constants.free, constants.lower)
    assert got.tolist() == exact.tolist() == [passed(cell, 1.0, constants) for cell in every]


def test_one_model_lowers_by_more_than_int16_holds():
    assert MODELS["a pass lowers by more than int16 holds"].constants.free < -(2**15)


@njit
def _all_ended(cells, constants):
    for k in range(cells.size):
        cells[k] = ended(cells[k], 1.0, constants)


@pytest.mark.parametrize("changes", [{}, {"p_free": 0.25, "p_occ": 0.75}, {"l_min": -0.5, "l_max": 0.25}])
def test_float64_cells_without_a_prior_change_as_those_with_a_prior_of_0(changes):
    """Bit for bit: of cells never updated, known to be even, and such that become even."""
    model = LogOdds("float64", **changes)
    constants, short = tuple(model.constants), model.by_cell[1]
    assert (len(short), constants) == (4, (*short, 0.0))
    cells = np.concatenate((np.linspace(-9.0, 9.0, 101), (0.0, -0.0, -model.d_free, -model.d_occ, 5e-324)))
    for update, compiled in ((passed, _all_passed), (ended, _all_ended)):
        one, other = cells.copy(), cells.copy()
        compiled(one, short)
        compiled(other, constants)
        plain = np.array([update(cell, 1.0, short) for cell in cells])
        assert one.tobytes() == other.tobytes() == plain.tobytes()


def test_a_prior_that_is_not_even_is_asked_for():
    assert LogOdds("float64", p_prior=0.4).by_cell[1][-1] == LogOdds("float64", p_prior=0.4).l0
    assert len(LogOdds("int16").by_cell[1]) == 5
