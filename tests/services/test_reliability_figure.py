"""The reliability diagram: what stands beside its axes has room."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg

from ogm_core.quality.reliability import CLASSES, Reliability
from ogm_services.results.reliability_figure import draw_reliability


def test_the_axes_names_are_within_the_figure_however_many_visits_there_were():
    shares = (np.arange(CLASSES) + 0.5) / CLASSES
    figure = draw_reliability({"rate": [Reliability(10 ** np.arange(CLASSES), shares, shares)]})
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    for axes in figure.axes:
        name = axes.yaxis.label.get_window_extent(canvas.get_renderer())
        assert name.x0 >= 0.0, axes.get_ylabel()
