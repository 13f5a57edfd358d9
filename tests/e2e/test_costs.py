"""The page docs/costs.md has the tables that its script writes, and what is counted in it follows the law."""

import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fleet import NO_MAP, RATE, ROBOTS, Fleet, NoMap
from benchmarks.growth import FACTORS, VARIANTS, Case, Factor, best_of, power_law, updates
from docs import costs
from docs.variants import with_table

PAGE = (Path(__file__).parents[2] / "docs" / "costs.md").read_text(encoding="utf-8")


def rows(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.strip().splitlines()]


def printed(name):
    return rows(re.search(f"<!-- table {name} -->\n(.*?)<!-- end of table -->", PAGE, re.DOTALL)[1])


@pytest.fixture(scope="module")
def counted():
    return costs.counts()


@pytest.fixture(scope="module")
def memory():
    return costs.memory_curves()


@pytest.fixture(scope="module")
def times():
    """Times that grow by the square of every factor."""
    squares = {
        name: {variant: 1e-6 * np.array(factor.values) ** 2.0 for variant in VARIANTS}
        for name, factor in {**FACTORS, ROBOTS.name: ROBOTS}.items()
    }
    squares["robots"][NO_MAP] = squares["robots"]["sector"] / 10.0
    return squares


def test_the_page_has_the_tables_that_the_script_writes(times, counted, memory):
    written = {name: rows(table) for name, table in costs.tables(times, counted, memory).items()}
    assert list(written) == re.findall("<!-- table (.*?) -->", PAGE)
    for name, table in written.items():
        assert [row[0] for row in table[1:]] == [row[0] for row in printed(name)[1:]], name
        assert [len(row) for row in table] == [len(row) for row in printed(name)], name
    for name in ("exponents", "updates"):
        assert [row[:3] for row in written[name]] == [row[:3] for row in printed(name)]
    assert written["updates"] == printed("updates")
    assert written["memory"] == printed("memory")
    page = PAGE
    for name, table in costs.tables(times, counted, memory).items():
        page = with_table(page, name, table)
    assert page.count("**2.00** (2.0, 2.0)") == 5 * len(VARIANTS)


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 2.0])
def test_a_power_law_is_found(exponent):
    x = np.array([1.0, 3.0, 10.0, 100.0])
    assert power_law(x, 7.0 * x**exponent) == pytest.approx((exponent, 7.0))
    scattered = 7.0 * x**exponent * np.exp([0.1, -0.1, -0.1, 0.1])
    slope = np.polynomial.Polynomial.fit(np.log(x), np.log(scattered), 1).convert().coef[1]
    assert power_law(x, scattered)[0] == pytest.approx(slope)


def test_only_what_is_to_be_fitted_is():
    factor = Factor("beams", (1, 2, 4, 8, 16), (2, 8), 1)
    assert factor.exponent(np.array([9.0, 2.0, 4.0, 8.0, 99.0])) == pytest.approx(1.0)
    assert costs.with_ends(factor, np.array([8.0, 2.0, 4.0, 8.0, 32.0])) == "**1.00** (-2.0, 2.0)"


LAW = {
    "beams": (1, 1, 0),
    "reach": (1, 1, 2),
    "resolution": (-1, -1, -2),
    "side": (0, 0, 0),
}
"""Exponents of cell updates with bresenham, dda and sector."""


@pytest.mark.parametrize("name", LAW)
def test_cell_updates_follow_the_law(counted, name):
    factor = FACTORS[name]
    assert factor.textbook == LAW[name][0]
    for variant, exponent in zip(VARIANTS, LAW[name], strict=True):
        assert factor.exponent(counted[name][variant]) == pytest.approx(exponent, abs=0.05), variant


def test_what_is_counted_is_a_beams_length_in_cells():
    """Bresenham's line takes max(|di|, |dj|) steps, on average 0.9 of the length: sqrt(8) / pi."""
    assert updates(Case(), "bresenham") == pytest.approx(720 * 200 * np.sqrt(8.0) / np.pi, rel=0.003)
    assert updates(Case(), "sector") == pytest.approx(np.pi * 201**2, rel=0.003)


def test_the_best_round_of_each_number_counts():
    rounds = {"a": iter([[3.0, 1.0], [1.0, 4.0]]), "b": iter([[5.0], [6.0]])}
    jobs = {
        ("f", "v", 0): lambda: np.array(next(rounds["a"])),
        ("f", "v", 1): lambda: np.array(next(rounds["b"])),
    }
    np.testing.assert_array_equal(best_of(jobs, 2)["f"]["v"], [1.0, 5.0])


@pytest.mark.parametrize("robots", [1, 3, 20])
def test_a_fleet_loses_no_scan(robots):
    with Fleet(robots, NoMap()) as fleet:
        assert (fleet.round() > 0.0).all()
        assert (fleet.round() > 0.0).all()
    status = fleet.receipts.status()
    scans = status.scans
    assert scans.received == scans.integrated == status.poses.received >= robots * RATE
    assert status.poses.late == 0
    assert len(status.robots) == robots


def test_the_figure(times, memory):
    figure = costs.draw(times, memory)
    labels = [axes.get_xlabel() for axes in figure.axes]
    assert labels == [*(axis for _, _, axis in costs.FACTOR_NAMES.values()), "known cells"]
    assert all(axes.get_ylabel() for axes in figure.axes)
    assert costs.FIGURE.read_bytes().startswith(b"<?xml")
    assert f'src="{costs.FIGURE.name}"' in PAGE
