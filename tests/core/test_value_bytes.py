"""Value bytes and the palettes that draw them, against their definitions cell by cell."""

import json
from pathlib import Path

import numpy as np
import pytest

import naive
from ogm_core.cells.classes import percent, probability_grey, ros_grey, trinary
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.value_bytes import COLOURS, legend, value_byte
from ogm_core.tiles.overviews import OVERVIEW_BYTES, make_overviews

VECTORS = Path(__file__).parents[1] / "data" / "tiles" / "value_bytes.json"
"""For readers of tiles in other languages, too."""
EVERY_BYTE = np.arange(256)
P = np.concatenate(
    [np.linspace(0.0, 1.0, 100_001), *(np.nextafter(p, (0.0, p, 1.0)) for p in (0.196, 0.65, 0.5))]
)
KNOWN = np.ones(P.shape, bool)


def test_every_probability_has_the_byte_of_its_definition():
    assert value_byte(P, KNOWN).tolist() == [naive.value_byte(p, True) for p in P.tolist()]


def test_the_byte_keeps_the_class_exactly_and_the_probability_nearly():
    found = value_byte(P, KNOWN)
    classes = trinary(P, KNOWN)
    assert np.array_equal((found >= 1) & (found <= 50), classes == 0)
    assert np.array_equal((found >= 51) & (found <= 166), classes == -1)
    assert np.array_equal(found >= 167, classes == 100)
    assert np.abs((found - 1.0) / 254.0 - P).max() <= 0.0036
    assert np.all(np.diff(value_byte(np.sort(P), KNOWN).astype(int)) >= 0)


def test_an_unknown_cell_is_0_whatever_its_probability():
    found = value_byte(P, ~KNOWN)
    assert found.dtype == np.uint8
    assert not found.any()


@pytest.mark.parametrize("model", [LogOdds(), LogOdds(p_prior=0.3, p_free=0.2, l_min=-2.0, l_max=3.5)])
def test_every_int16_cell(model):
    every = np.arange(-(2**15), 2**15).astype(np.int16)
    found = model.encode(every.reshape(256, 256), value_byte).ravel()
    p = model.probability(every).tolist()
    assert found.tolist() == [naive.value_byte(p[k], bool(cell)) for k, cell in enumerate(every.tolist())]


def test_the_file_of_examples():
    examples = json.loads(VECTORS.read_text())
    assert len(examples["cells"]) > 20
    for p, byte in examples["cells"]:
        assert value_byte(np.array([p or 0.0]), np.array([p is not None])).tolist() == [byte]
    tile = np.zeros((64, 64), np.uint8)
    for k, (block, _) in enumerate(examples["blocks"]):
        tile[:2, 2 * k % 64 : 2 * k % 64 + 2] = np.reshape(block, (2, 2))
        found = np.zeros((1, OVERVIEW_BYTES), np.uint8)
        make_overviews(tile, found)
        assert found[0, k % 32] == examples["blocks"][k][1]


def drawn(palette, p=P, known=KNOWN):
    """Colours of cells of these probabilities."""
    return COLOURS[palette][value_byte(p, known)].astype(int)


def test_palettes_by_name():
    assert list(COLOURS) == ["ros", "probability", "cividis", "dark", "costmap"]
    for colours in COLOURS.values():
        assert (colours.shape, colours.dtype, colours.flags.writeable) == ((256, 3), np.uint8, False)


def test_palettes_of_greys_are_those_of_grey_pictures():
    for known in (KNOWN, ~KNOWN):
        assert np.array_equal(drawn("ros", known=known), np.repeat(ros_grey(P, known)[:, None], 3, axis=1))
        off = drawn("probability", known=known) - probability_grey(P, known)[:, None]
        assert np.abs(off).max() <= (1 if known.all() else 0)


def test_cividis_grows_lighter_all_the_way():
    lightness = COLOURS["cividis"][1:] @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(lightness[3:] - lightness[:-3] > 0.5)  # of neighbours a rounded blue may be the lesser


def test_cividis_is_cividis():
    matplotlib = pytest.importorskip("matplotlib")
    theirs = 255 * matplotlib.colormaps["cividis"]((EVERY_BYTE[1:] - 1) / 254)[:, :3]
    assert np.abs(COLOURS["cividis"][1:] - theirs).max() <= 9


def test_dark_has_a_colour_for_each_class():
    classes = np.array(["unknown", *["free"] * 50, *["undecided"] * 116, *["occupied"] * 89])
    colours = {
        "unknown": (0x1B, 0x1E, 0x22),
        "free": (0x3A, 0x3A, 0x3A),
        "undecided": (0x28, 0x28, 0x28),
        "occupied": (0xEB, 0xEB, 0xEB),
    }
    assert COLOURS["dark"].tolist() == [list(colours[name]) for name in classes]


def test_costmap_has_the_colours_of_rviz():
    p = (EVERY_BYTE[1:] - 1) / 254
    costs = percent(p, np.ones(255, bool)).tolist()
    assert set(costs) == set(range(101))
    expected = [
        {0: [48] * 3, 99: [0, 255, 255], 100: [255, 0, 255]}.get(
            cost, [255 * cost // 100, 0, 255 - 255 * cost // 100]
        )
        for cost in costs
    ]
    assert COLOURS["costmap"][1:].tolist() == expected
    assert COLOURS["costmap"][0].tolist() == [0x70, 0x89, 0x86]


def test_a_legend_names_colours():
    meanings = ("occupied", "free", "undecided", "unknown")
    colours = {palette: tuple(legend(palette)[meaning] for meaning in meanings) for palette in COLOURS}
    assert colours["ros"] == ("#000000", "#fefefe", "#cdcdcd", "#cdcdcd")
    assert colours["dark"] == ("#ebebeb", "#3a3a3a", "#282828", "#1b1e22")
    assert colours["costmap"] == ("#ff00ff", "#303030", "#7f0080", "#708986")
