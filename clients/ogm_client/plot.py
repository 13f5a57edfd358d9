"""Plot of a map with matplotlib, in metres; matplotlib is loaded when something is drawn."""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from ogm_core.errors import MapEmpty, MissingExtra
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import RobotStatus

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

LARGEST: Final = 2000
"""No side of the picture is longer, pixels: larger maps are shrunk."""
UNKNOWN: Final = "#cfe0ee"
"""What is unknown, and what lies outside the map."""
ROBOTS: Final = ("#0072b2", "#009e73", "#cc79a7", "#56b4e9", "#5d3a9b", "#e69f00")
"""Colours that the colour-blind tell apart."""
_ARROW = 18.0
"""Length of a robot's arrow, points."""


def current_axes() -> "Axes":
    """The axes that pyplot draws into.

    Raises:
        MissingExtra: matplotlib is not installed.
    """
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise MissingExtra(
            "plots are drawn by matplotlib, which is not installed: pip install matplotlib"
        ) from error
    return pyplot.gca()


def plot_map(axes: "Axes", snapshot: MapSnapshot, robots: Mapping[str, RobotStatus]) -> None:
    """Draw a map and where robots are; both axes are in metres and equally long.

    Raises:
        MapEmpty: there is no cell to draw.
    """
    if snapshot.empty:
        raise MapEmpty("the map has no known cell yet")
    draw_cells(axes, snapshot.shrink(LARGEST))
    axes.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    for k, (name, robot) in enumerate(sorted(robots.items())):
        if robot.pose is not None and not robot.gone:
            _draw_robot(axes, name, robot, ROBOTS[k % len(ROBOTS)])


def draw_cells(axes: "Axes", shown: MapSnapshot) -> "AxesImage":
    """Draw the cells where they lie: black is occupied, white free, and what is unknown in `UNKNOWN`."""
    import matplotlib as mpl

    ix, iy, width, height = shown.rect
    xmin, ymin = shown.origin
    xmax, ymax = shown.lattice.corner_of(ix + width, iy + height)
    axes.set_facecolor(UNKNOWN)
    probability, known = shown.published()
    return axes.imshow(
        np.ma.masked_where(~known, probability),
        cmap=mpl.colormaps["gray_r"].with_extremes(bad=UNKNOWN),
        vmin=0.0,
        vmax=1.0,
        origin="lower",
        extent=(xmin, xmax, ymin, ymax),
        interpolation="nearest",
    )


def _draw_robot(axes: "Axes", name: str, robot: RobotStatus, color: str) -> None:
    """A dot, an arrow to where it looks, and its name."""
    assert robot.pose is not None
    x, y, theta = robot.pose
    offset: dict[str, Any] = {"xycoords": "data", "textcoords": "offset points"}
    ahead = _ARROW * math.cos(theta), _ARROW * math.sin(theta)
    axes.plot([x], [y], marker="o", markersize=4.0, color=color, linestyle="none", label=name)
    axes.annotate(
        "", xy=(x, y), xytext=ahead, arrowprops={"arrowstyle": "<-", "color": color, "shrinkA": 0.0}, **offset
    )
    above = math.sin(theta) < 0.0  # where the arrow is not
    place: dict[str, Any] = {"ha": "center", "va": "bottom" if above else "top"}
    name_at = 0.0, 5.0 if above else -5.0
    axes.annotate(name, xy=(x, y), xytext=name_at, color=color, parse_math=False, **place, **offset)
