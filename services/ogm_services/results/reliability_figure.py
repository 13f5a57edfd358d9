"""Reliability diagram: what maps say of their cells against how often held-out beams end there.

Loads matplotlib, as `figure` does.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from ogm_client.plot import ROBOTS
from ogm_core.errors import printable
from ogm_core.quality.reliability import CLASSES, Reliability
from ogm_services.results.figure import DPI, own_style

SIZE = 3.6, 4.6
"""Width and height, inches."""


def draw_reliability(found: Mapping[str, Sequence[Reliability]]) -> Figure:
    """Draw a curve for each model, of all its maps together, and below it how often its cells were visited.

    On the diagonal, beams end in cells as often as the cells' probability says.
    """
    with own_style():
        figure = Figure(figsize=SIZE, dpi=DPI)
        curves = figure.add_axes((0.16, 0.36, 0.8, 0.6))
        visits = figure.add_axes((0.16, 0.1, 0.8, 0.2))
        curves.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=0.6, linestyle="dashed")
        for k, (model, parts) in enumerate(found.items()):
            _draw_model(curves, visits, k, len(found), printable(model), parts)
        ticks = np.linspace(0.0, 1.0, 6).tolist()
        curves.set(xlim=(0, 1), ylim=(0, 1), xticks=ticks, yticks=ticks, ylabel="beams that end in the cell")
        visits.set(xlim=(0, 1), yscale="log", xticks=ticks, xlabel="p(occupied) of the cell", ylabel="visits")
        visits.yaxis.set_major_formatter(EngFormatter(sep=""))  # 1M: as long as there is room for
        curves.legend(loc="upper left", borderaxespad=0.8)
    return figure


def _draw_model(
    curves: Axes, visits: Axes, k: int, models: int, name: str, parts: Sequence[Reliability]
) -> None:
    """The k-th model's curve, and its bars beside those of the others."""
    counts = np.sum([part.visits for part in parts], axis=0)
    seen = counts > 0
    predicted, ended = (
        np.sum([np.nan_to_num(values) * part.visits for part, values in pairs], axis=0)[seen] / counts[seen]
        for pairs in (
            [(part, part.predicted) for part in parts],
            [(part, part.ended) for part in parts],
        )
    )
    colour, width = ROBOTS[k % len(ROBOTS)], 0.8 / CLASSES / models
    curves.plot(predicted, ended, color=colour, linewidth=0.9, marker="o", markersize=2.5, label=name)
    left = (np.arange(CLASSES) + 0.1) / CLASSES + k * width
    visits.bar(left[seen], counts[seen], width, color=colour, align="edge")
