"""Writes the tables of docs/costs.md and draws its figure: how the cost of mapping grows, and with what."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from benchmarks.__main__ import machine
from benchmarks.fleet import NO_MAP, RATE, ROBOTS, measured_fleets
from benchmarks.growth import (
    FACTORS,
    VARIANTS,
    Case,
    Costs,
    Factor,
    Floats,
    measured,
    place,
    power_law,
    updates,
)
from docs.variants import markdown, with_table
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import PlacedScan, Pose
from ogm_services.results.figure import encode_figure

PAGE = Path(__file__).with_name("costs.md")
FIGURE = Path(__file__).with_name("costs.svg")
ROUNDS, FLEET_ROUNDS = 25, 20

FACTOR_NAMES = {
    "beams": ("beams of a scan", "", "beams of a scan"),
    "reach": ("range", " m", "range of the beams, m"),
    "resolution": ("resolution", " m", "resolution, m a cell"),
    "side": ("side of the known map", " cells", "side of the known map, cells"),
    "robots": ("robots", "", "robots, 20 messages a second each"),
}
"""What a factor is called in tables, its unit there, and what stands at its axis."""
LOOKS = {
    "bresenham": {"color": "#0072b2", "marker": "o"},
    "dda": {"color": "#d55e00", "marker": "s"},
    "sector": {"color": "#009e73", "marker": "^"},
    NO_MAP: {"color": "0.45", "marker": "x"},
}
"""Colours and marks that the colour-blind tell apart."""
LABELS = {NO_MAP: "the service without its map"}
ROOM_RADII = (1.0, 2.5, 5.0, 10.0, 20.0, 40.0)
CORRIDOR_LENGTHS = (10, 30, 100, 300, 1000)
ROOMY = 10**9
"""`max_cells` of maps whose memory is looked at: a diagonal corridor lies in a large rectangle."""
_STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.0,
    "lines.markersize": 3.5,
    "legend.frameon": False,
    "svg.hashsalt": "ogm",
}


def main() -> None:
    """Measure, count, and write everything."""
    costs = measured(FACTORS.values(), ROUNDS) | measured_fleets((*VARIANTS, NO_MAP), FLEET_ROUNDS)
    memory = memory_curves()
    page = PAGE.read_text(encoding="utf-8")
    for name, table in tables(costs, counts(), memory).items():
        page = with_table(page, name, table)
    PAGE.write_text(page, encoding="utf-8")
    FIGURE.write_bytes(encode_figure(draw(costs, memory), "svg"))


def tables(costs: Costs, counted: Costs, memory: dict[str, Floats]) -> dict[str, str]:
    """The page's tables by name."""
    factors = {**FACTORS, "robots": ROBOTS}
    return {
        "exponents": growth_table(factors, costs, with_ends),
        "updates": growth_table(FACTORS, counted, without_ends),
        "times": times_table(costs),
        "memory": memory_table(memory),
    }


def counts() -> Costs:
    """Cell updates of a scan: the same on every machine."""
    return {
        name: {variant: np.array([updates(case, variant) for case in factor.cases()]) for variant in VARIANTS}
        for name, factor in FACTORS.items()
    }


def growth_table(factors: dict[str, Factor], costs: Costs, cell: Callable[[Factor, Floats], str]) -> str:
    """Exponents by factor and variant."""
    rows = [["factor", "fitted over", "textbook", *VARIANTS]]
    for name, factor in factors.items():
        called, unit, _ = FACTOR_NAMES[name]
        low, high = factor.fitted
        fitted = f"{low:g} to {high:g}{unit}"
        rows.append(
            [
                called,
                fitted,
                str(factor.textbook),
                *(cell(factor, costs[name][variant]) for variant in VARIANTS),
            ]
        )
    return markdown(rows)


def with_ends(factor: Factor, costs: Floats) -> str:
    """The exponent over what is fitted; in brackets those of the first and the last step of all values."""
    values = np.array(factor.values)
    first, last = (power_law(values[ends], costs[ends])[0] for ends in (slice(2), slice(-2, None)))
    return f"**{factor.exponent(costs):.2f}** ({round(first, 1) + 0.0:.1f}, {round(last, 1) + 0.0:.1f})"


def without_ends(factor: Factor, counted: Floats) -> str:
    """The exponent over what is fitted."""
    return f"{round(factor.exponent(counted), 2) + 0.0:.2f}"  # no -0.00


def times_table(costs: Costs) -> str:
    """Absolute times of the common case, and what the service adds to a scan."""
    usual, robots = FACTORS["beams"], 16
    at, fleet = usual.values.index(Case().beams), ROBOTS.values.index(robots)
    scans = 1e-6 * robots * RATE
    return markdown(
        [
            [f"on {machine()}", *VARIANTS],
            ["a scan of the common case", *(f"{1e6 * costs['beams'][v][at]:.0f} us" for v in VARIANTS)],
            [
                "a cell update of it",
                *(f"{1e9 * costs['beams'][v][at] / updates(Case(), v):.2f} ns" for v in VARIANTS),
            ],
            [
                "a scan and a pose of a robot",
                *(f"{costs['robots'][v][fleet] / scans:.0f} us" for v in VARIANTS),
            ],
            [
                "of these, without the map",
                *[f"{costs['robots'][NO_MAP][fleet] / scans:.0f} us"] * len(VARIANTS),
            ],
        ]
    )


def memory_curves() -> dict[str, Floats]:
    """Known cells and bytes of each, shape (2, sizes), of maps of several shapes."""
    rng = np.random.default_rng(1)
    curves = {"round room": [[place(1440, r, Pose(0.0, 0.0, 0.0), rng)] for r in ROOM_RADII]}
    for name, bearing in {"corridor, along an axis": 0.0, "corridor, diagonal": math.pi / 4}.items():
        stops = [np.arange(0.0, length, 0.5) for length in CORRIDOR_LENGTHS]
        turned = math.cos(bearing), math.sin(bearing)
        curves[name] = [
            [place(180, 1.0, Pose(turned[0] * s, turned[1] * s, 0.0), rng) for s in along] for along in stops
        ]
    return {name: np.array([_memory(scans) for scans in maps]).T for name, maps in curves.items()}


def _memory(scans: Iterable[PlacedScan]) -> tuple[int, float]:
    grid = OccupancyGrid(GridSettings(sensor_model="sector", max_cells=ROOMY))
    for scan, pose, _ in scans:
        grid.integrate(scan, pose)
    known = grid.snapshot().known_cells
    return known, grid.nbytes / known


def memory_table(memory: dict[str, Floats]) -> str:
    """Bytes of a known cell in the smallest and the largest map of each shape."""
    rows = [["map of a", "smallest", "largest"]]
    for name, (known, each) in memory.items():
        rows.append([name, *(f"{known[k]:,.0f} known cells, {each[k]:.1f} bytes each" for k in (0, -1))])
    return markdown(rows)


def draw(costs: Costs, memory: dict[str, Floats]) -> Figure:
    """One plot a factor, and one of memory."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        figure = Figure(figsize=(9.0, 5.4), layout="constrained")
        plots = figure.subplots(2, 3)
        for axes, (name, factor) in zip(plots.flat, {**FACTORS, "robots": ROBOTS}.items(), strict=False):
            _draw_growth(axes, factor, costs[name])
            axes.set(xlabel=FACTOR_NAMES[name][2], ylabel="CPU time of a scan, ms")
        plots[1, 1].set(ylabel="CPU time a second, ms")
        _draw_memory(plots[1, 2], memory)
        handles, labels = plots[1, 1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=5)
    return figure


def _draw_growth(axes: Axes, factor: Factor, costs: dict[str, Floats]) -> None:
    """Measured points, and over the values that are fitted the line of their exponent."""
    values = np.array(factor.values)
    chosen = values[(values >= factor.fitted[0]) & (values <= factor.fitted[1])]
    for variant, row in costs.items():
        look = LOOKS[variant]
        axes.loglog(values, 1e3 * row, linestyle=":", label=LABELS.get(variant, variant), **look)
        exponent, level = power_law(chosen, 1e3 * row[np.isin(values, chosen)])
        axes.loglog(chosen, level * chosen**exponent, color=look["color"])
    # Half of what bresenham costs in the middle: out of the other lines' way.
    middle = len(chosen) // 2
    anchor = 0.5e3 * costs["bresenham"][values == chosen[middle]][0]
    slope = anchor * (chosen / chosen[middle]) ** factor.textbook
    axes.loglog(chosen, slope, "k--", linewidth=0.8, label="textbook's slope")
    low, high = axes.get_ylim()
    if high < 10.0 * low:  # what hardly grows shall look like it
        axes.set_ylim(low / 2.0, high * 2.0)
    _plain_ticks(axes)


def _draw_memory(axes: Axes, memory: dict[str, Floats]) -> None:
    """Bytes of a known cell, of which the cell itself is two; the shapes are named beside their lines."""
    for (name, (known, each)), mark in zip(memory.items(), "Dv*", strict=True):
        axes.loglog(known, each, marker=mark, color="0.2", label=name)
    axes.axhline(2.0, color="0.6", linewidth=0.8)
    axes.annotate("a cell itself", (1000.0, 2.0), (0, 2), textcoords="offset points")
    axes.set(xlabel="known cells", ylabel="bytes of the map a known cell")
    axes.legend()
    _plain_ticks(axes)


def _plain_ticks(axes: Axes) -> None:
    """Numbers as people write them, at the powers of ten."""
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:,.10g}")
        axis.set_minor_formatter(NullFormatter())


if __name__ == "__main__":
    main()
