import numpy as np
import pytest

from ogm_core.cells.classes import percent, probability_grey, ros_grey, trinary
from ogm_core.cells.log_odds import LogOdds

ENCODERS = [trinary, ros_grey, probability_grey, percent]
KNOWN = [
    # p, trinary, ros_grey, probability_grey, percent
    (0.0, 0, 254, 0, 0),
    (0.004, 0, 254, 1, 0),
    (0.005, 0, 254, 1, 1),
    (0.195, 0, 254, 50, 20),
    (np.nextafter(0.196, 0), 0, 254, 50, 20),
    (0.196, -1, 205, 50, 20),
    (0.5, -1, 205, 128, 50),
    (0.65, -1, 205, 166, 65),
    (np.nextafter(0.65, 1), 100, 0, 166, 65),
    (0.994, 100, 0, 253, 99),
    (0.995, 100, 0, 254, 100),
    (1.0, 100, 0, 255, 100),
]


@pytest.mark.parametrize(("column", "encoder"), list(enumerate(ENCODERS, start=1)))
def test_known_cells(column, encoder):
    p = np.array([row[0] for row in KNOWN])
    got = encoder(p, np.ones(p.shape, bool))
    assert got.tolist() == [row[column] for row in KNOWN]


@pytest.mark.parametrize(
    ("encoder", "unknown", "dtype"),
    [
        (trinary, -1, np.int8),
        (ros_grey, 205, np.uint8),
        (probability_grey, 127, np.uint8),
        (percent, -1, np.int8),
    ],
)
def test_unknown_cells_show_nothing_of_their_probability(encoder, unknown, dtype):
    p = np.array([[0.0, 0.1, 0.5], [0.7, 0.9, 1.0]])
    got = encoder(p, np.zeros(p.shape, bool))
    assert got.dtype == dtype
    assert got.tolist() == [[unknown] * 3] * 2


def one_cell(encoder, model, stored):
    """The definition, a cell at a time, in Python's own arithmetic."""
    p = 1.0 / (1.0 + np.exp(-(model.l0 + (stored // 2) * model.step)))
    undecided = not stored or 0.196 <= p <= 0.65
    match encoder.__name__:
        case "trinary":
            return -1 if undecided else 100 if p > 0.65 else 0
        case "ros_grey":
            return 205 if undecided else 0 if p > 0.65 else 254
        case "probability_grey":
            return int(255 * p + 0.5) if stored else 127
        case _:
            return int(100 * p + 0.5) if stored else -1


@pytest.mark.parametrize("encoder", ENCODERS)
@pytest.mark.parametrize("model", [LogOdds(), LogOdds(p_prior=0.3, p_free=0.2, l_min=-2.0, l_max=3.5)])
def test_table_agrees_with_the_definition_for_every_int16(encoder, model):
    every = np.arange(-(2**15), 2**15).astype(np.int16)
    got = model.encode(every.reshape(256, 256), encoder)
    assert got.shape == (256, 256)
    assert got.ravel().tolist() == [one_cell(encoder, model, int(stored)) for stored in every]


@pytest.mark.parametrize("encoder", ENCODERS)
def test_float64_cells_need_no_table(encoder):
    model = LogOdds("float64")
    cells = np.array([[0.0, -0.0, 8.0], [-8.0, 0.62, -1.41]])
    p = 1.0 / (1.0 + np.exp(-cells))
    known = np.array([[False, True, True], [True, True, True]])
    assert np.array_equal(model.encode(cells, encoder), encoder(p, known))
