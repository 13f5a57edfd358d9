import math

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds, logit, probability_of
from ogm_core.errors import BadSetting

SKEWED = {"p_prior": 0.3, "p_free": 0.2, "p_occ": 0.8, "l_min": -4.0, "l_max": 6.0}


def test_logit_is_clipped():
    assert logit(0.5) == 0.0
    assert logit(0.7) == pytest.approx(0.8472978603872037, abs=1e-15)
    assert logit(0.0) == logit(1e-12) == math.log(1e-9 / (1 - 1e-9))
    assert logit(1.0) == pytest.approx(-logit(0.0), rel=1e-6)


def test_probability_of_extremes():
    got = probability_of(np.array([-1000.0, 0.0, 1000.0, math.log(4.0)]))
    assert got.tolist() == [0.0, 0.5, 1.0, pytest.approx(0.8, abs=1e-15)]


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_untouched_memory_is_unknown_and_has_the_prior(cells):
    model = LogOdds(cells, **SKEWED)
    memory = np.zeros((2, 3), model.dtype)
    assert not model.known(memory).any()
    assert model.log_odds(memory).tolist() == [[logit(0.3)] * 3] * 2
    assert model.probability(memory) == pytest.approx(np.full((2, 3), 0.3), abs=1e-15)


def test_int16_known_bit():
    model = LogOdds(**SKEWED)
    stored = np.array([0, 1, -1, 2 * 7 | 1, 2 * -7 | 1], np.int16)
    assert model.known(stored).tolist() == [False, True, True, True, True]
    steps = [0, 0, -1, 7, -7]
    assert model.log_odds(stored).tolist() == [model.l0 + q * model.step for q in steps]


def test_float64_known_zero_is_minus_zero():
    model = LogOdds("float64", **SKEWED)
    stored = np.array([0.0, -0.0, 1.5, -1.5, 5e-324])
    assert model.known(stored).tolist() == [False, True, True, True, True]
    got = model.log_odds(stored)
    assert got.tolist() == [model.l0, 0.0, 1.5, -1.5, 5e-324]
    assert not np.signbit(got[1])
    assert model.probability(stored)[1] == 0.5


@pytest.mark.parametrize("cells", ["int16", "float64"])
def test_known_reads_views_of_any_stride(cells):
    model = LogOdds(cells)
    stored = np.zeros((6, 6), model.dtype)
    stored[::2, ::3] = 1
    assert model.known(stored[::2, ::3]).all()
    assert not model.known(stored[1::2, 1::3]).any()
    assert model.probability(stored[::-1].T).shape == (6, 6)


def test_step_reaches_the_farther_clamp():
    model = LogOdds(**SKEWED)
    assert model.l0 == math.log(0.3 / 0.7)
    assert model.step == (6.0 - model.l0) / 16383
    assert model.constants.upper == 2 * 16383
    assert model.constants.lower == 2 * round((-4.0 - model.l0) / model.step)
    assert LogOdds(l_min=-9.0, l_max=3.0).step == 9.0 / 16383


def test_update_in_stored_units():
    exact = LogOdds("float64", **SKEWED).constants
    l0 = math.log(0.3 / 0.7)
    assert exact == pytest.approx((math.log(0.25) - l0, math.log(4.0) - l0, -4.0, 6.0, l0), abs=1e-14)
    model = LogOdds(**SKEWED)
    fixed = model.constants
    assert all(type(value) is int for value in fixed)
    assert fixed.free == 2 * round((math.log(0.25) - l0) / model.step)
    assert fixed.occupied == 2 * round((math.log(4.0) - l0) / model.step)
    assert fixed.prior == 0


@pytest.mark.parametrize("settings", [{}, SKEWED, {"l_min": -9.0, "l_max": 3.0}])
def test_int16_stores_the_nearest_step_and_the_known_bit(settings):
    model = LogOdds(**settings)
    wanted = np.random.default_rng(3).uniform(-10.0, 10.0, (40, 50))
    known = np.random.default_rng(4).random((40, 50)) < 0.8
    cells = model.store(wanted, known)
    assert (cells.dtype, cells.shape) == (np.int16, (40, 50))
    assert np.array_equal(model.known(cells), known)
    clamped = np.clip(wanted, model.l_min, model.l_max)
    assert np.abs(model.log_odds(cells) - clamped)[known].max() <= 0.5001 * model.step
    assert not cells[~known].any()
    lower, upper = (value + 1 for value in model.constants[2:4])
    assert (cells[known].min(), cells[known].max()) == (lower, upper), (
        "the clamps, as a beam would reach them"
    )


def test_int16_store_is_the_inverse_of_log_odds():
    model = LogOdds(**SKEWED)
    cells = np.arange(model.constants.lower + 1, model.constants.upper + 2, 2, dtype=np.int16)
    assert np.array_equal(model.store(model.log_odds(cells), np.ones(cells.shape, np.bool_)), cells)


def test_float64_stores_log_odds_as_they_are_and_zero_as_minus_zero():
    model = LogOdds("float64", **SKEWED)
    wanted = np.array([0.0, -0.0, 1 / 3, -7.5, 99.0, 0.0, 5.0])
    known = np.array([True, True, True, True, True, False, False])
    cells = model.store(wanted, known)
    assert cells.dtype == np.float64
    assert model.known(cells).tolist() == known.tolist()
    assert cells.tolist() == [0.0, 0.0, 1 / 3, -4.0, 6.0, 0.0, 0.0]
    assert np.signbit(cells).tolist() == [True, True, False, True, False, False, False]
    assert model.log_odds(cells)[:5].tolist() == [0.0, 0.0, 1 / 3, -4.0, 6.0]


def test_a_known_zero_at_a_clamp_stays_known():
    model = LogOdds("float64", p_prior=0.3, p_occ=0.6, p_free=0.2, l_min=-4.0, l_max=0.0)
    assert model.known(model.store(np.array([3.0]), np.array([True]))).tolist() == [True]


def test_increments_never_exceed_the_distance_between_the_clamps():
    update = LogOdds(p_occ=1.0, p_free=0.0, l_min=-0.5, l_max=0.25).constants
    assert update.upper - update.lower == update.occupied == -update.free


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"p_free": 0.6}, "p_free < p_prior < p_occ"),
        ({"p_occ": 0.4}, "p_free < p_prior < p_occ"),
        ({"p_free": 0.5}, "p_free < p_prior < p_occ"),
        ({"p_occ": 0.5}, "p_free < p_prior < p_occ"),
        ({"p_prior": 0.0, "p_free": 0.0}, "p_free < p_prior < p_occ"),
        ({"p_prior": 1e-10, "p_free": 0.0}, "p_free < p_prior < p_occ"),
        ({"p_occ": 1.5}, "from 0 to 1"),
        ({"p_free": -0.1}, "from 0 to 1"),
        ({"p_prior": math.nan}, "finite"),
        ({"l_max": math.inf}, "finite"),
        ({"l_min": -math.inf}, "finite"),
        ({"l_min": 0.0}, "l_min < logit"),
        ({"l_max": 0.0}, "l_min < logit"),
        ({"l_min": 8.0, "l_max": -8.0}, "l_min < logit"),
        ({"p_prior": 0.9, "p_occ": 0.95, "l_max": 2.0}, "l_min < logit"),
        ({"p_occ": 0.50005}, "int16 step"),
        ({"p_free": 0.49995}, "int16 step"),
        ({"l_max": 1e6}, "int16 step"),
    ],
)
def test_refused_settings(settings, says):
    with pytest.raises(BadSetting, match=says):
        LogOdds(**settings)


def test_weak_observations_fit_float64():
    assert LogOdds("float64", p_occ=0.50005).d_occ == pytest.approx(2e-4, rel=1e-3)


def test_int16_stays_within_0_002_of_float64_in_the_lab():
    """Cells with every bias towards occupied and free, 3000 observations each, clamps included."""
    fixed, exact = LogOdds("int16"), LogOdds("float64")
    rng = np.random.default_rng(5)
    share = np.linspace(0.0, 1.0, 401)
    q, log_odds = np.zeros(401, np.int64), np.zeros(401)
    worst = 0.0
    for _ in range(3000):
        hit = rng.random(401) < share
        u, v = fixed.constants, exact.constants
        q = np.clip(q + np.where(hit, u.occupied, u.free), u.lower, u.upper)
        log_odds = np.clip(log_odds + np.where(hit, v.occupied, v.free), v.lower, v.upper)
        stored = (q | 1).astype(np.int16)
        known_l = np.where(log_odds == 0.0, -0.0, log_odds)
        worst = max(worst, np.abs(fixed.probability(stored) - exact.probability(known_l)).max())
    assert 0.0 < worst < 0.002
