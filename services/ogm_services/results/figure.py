"""Figure of a map as textbooks print it: probabilities in grey, axes in metres, obstacles, robots' ways.

Loads matplotlib, which is the extra `plot`: import this only where a figure is wanted.
"""

import io
import math
import textwrap
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path
from matplotlib.ticker import MultipleLocator
from numpy.typing import NDArray

from ogm_client.plot import ROBOTS, UNKNOWN, draw_cells
from ogm_core.errors import printable
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.pictures.scale_bar import round_length
from ogm_core.simulation.worlds import World
from ogm_core.snapshot import MapSnapshot
from ogm_services.results.driven_paths import DrivenPath

DPI = 300
LONGEST = 1800
"""Pixels of the map's longer side, at most: larger maps are shrunk. A cell is a whole number of pixels."""
NARROWEST, LOWEST = 1050, 600
"""Pixels of the axes' width and height, at least."""
MARGIN = 0.02
"""What is shown around the map, as a share of its longer side."""
TICKS = 6
"""About so many ticks along the longer side."""
OBSTACLES = "#d55e00"
_STYLE: dict[Any, Any] = {
    "font.size": 8,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.borderaxespad": 0.0,
    "legend.borderpad": 0.0,
    "pdf.fonttype": 42,
    "svg.hashsalt": "ogm",
    "text.parse_math": False,
}
_LEFT, _RIGHT = 0.7, 0.95
"""Room beside the axes, inches."""
_LINE = 0.16
"""Height of a line of text, inches."""
_SAMPLES = np.linspace(0.0, 2.0 * math.pi, 361)

Floats = NDArray[np.float64]


def draw_map(
    snapshot: MapSnapshot, name: str, description: str, world: World | None, paths: Mapping[str, DrivenPath]
) -> Figure:
    """Draw a map that is not empty, its world's obstacles as outlines, and the robots' paths by their names.

    Shown are the map and a little around it, north up, under its name and its description.
    """
    shown = snapshot.shrink(LONGEST)
    if shown.factor > snapshot.factor:
        description += f", drawn in blocks of {shown.resolution:g} m"
    frame = _frame(shown)
    with own_style():
        figure = Figure(dpi=DPI)
        main, bar = figure.add_axes((0.0, 0.0, 1.0, 1.0)), figure.add_axes((0.0, 0.0, 1.0, 1.0))
        image = draw_cells(main, shown)
        figure.colorbar(image, cax=bar, ticks=[0.0, 0.25, 0.5, 0.75, 1.0], label="p(occupied)")
        handles: list[Artist] = [Patch(facecolor=UNKNOWN, edgecolor="0.5", linewidth=0.5, label="unknown")]
        if world is not None:
            handles.append(_draw_obstacles(main, world, frame.view))
        handles += _draw_paths(main, paths)
        _set_axes(main, frame.view)
        _lay_out(figure, frame, name, description, handles)
    return figure


def describe(snapshot: MapSnapshot, settings: GridSettings) -> str:
    """What a map was made with: number of scans, resolution, sensor model, and how beams count."""
    scans = "1 scan" if snapshot.scans == 1 else f"{snapshot.scans} scans"
    way = f", traversal {settings.traversal}" if settings.sensor_model == "beam" else ""
    if settings.cell_model.lengths:
        way = ", cell model rate"
    return f"{scans}, resolution {snapshot.lattice.resolution:g} m, model {settings.sensor_model}{way}"


def encode_figure(figure: Figure, form: str) -> bytes:
    """A figure as a file: png, pdf or svg. Equal figures give equal bytes."""
    undated: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    file = io.BytesIO()
    with own_style(), warnings.catch_warnings():
        # What the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from", UserWarning)
        figure.savefig(file, format=form, metadata=undated.get(form))
    return file.getvalue()


@contextmanager
def own_style() -> Iterator[None]:
    """Inside, matplotlib draws as we say, whatever the user's matplotlibrc says."""
    with mpl.rc_context():
        mpl.rcdefaults()
        mpl.rcParams.update(_STYLE)
        yield


@dataclass(frozen=True, slots=True)
class _Frame:
    """What the axes show, and their size in inches: whole pixels, and as many for every cell."""

    view: Region
    width: float
    height: float


def _frame(shown: MapSnapshot) -> _Frame:
    longer = max(shown.width, shown.height)
    margin = math.ceil(MARGIN * longer)
    pixels = max(1, LONGEST // (longer + 2 * margin))
    beside, above = (
        max(margin, math.ceil((least / pixels - cells) / 2))
        for cells, least in ((shown.width, NARROWEST), (shown.height, LOWEST))
    )
    (ix, iy), factor = shown.offset, shown.factor
    columns, rows = shown.width + 2 * beside, shown.height + 2 * above
    ix, iy = ix - beside * factor, iy - above * factor
    corners = (
        *shown.lattice.corner_of(ix, iy),
        *shown.lattice.corner_of(ix + columns * factor, iy + rows * factor),
    )
    return _Frame(Region(*corners), columns * pixels / DPI, rows * pixels / DPI)


def _set_axes(axes: Axes, view: Region) -> None:
    """Both axes show the view in metres, with ticks equally far apart."""
    axes.set(xlim=view[::2], ylim=view[1::2], xlabel="x (m)", ylabel="y (m)")
    step = round_length(max(view.xmax - view.xmin, view.ymax - view.ymin) / TICKS)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(MultipleLocator(step))


def _draw_obstacles(axes: Axes, world: World, view: Region) -> Line2D:
    outlines = PathPatch(_outlines(world, view), fill=False, edgecolor=OBSTACLES, linewidth=0.5)
    outlines.set_capstyle("projecting")
    axes.add_patch(outlines)
    return Line2D([], [], color=OBSTACLES, linewidth=0.5, label="true obstacles")


def _outlines(world: World, view: Region) -> Path:
    """The obstacles that come near the view, m; circles as polygons."""
    ends = world.segments.reshape(-1, 2, 2)
    ends = ends[_reach_into(view, ends.min(axis=1), ends.max(axis=1))]
    centres, radii = world.circles[:, :2], world.circles[:, 2:]
    near = _reach_into(view, centres - radii, centres + radii)
    turn = np.stack((np.cos(_SAMPLES), np.sin(_SAMPLES)), axis=1)
    rounds = centres[near, np.newaxis] + radii[near, np.newaxis] * turn
    codes = [np.full(line.shape[:2], Path.LINETO, Path.code_type) for line in (ends, rounds)]
    for code in codes:
        code[:, 0] = Path.MOVETO
    return Path(
        np.concatenate([line.reshape(-1, 2) for line in (ends, rounds)]),
        np.concatenate([code.ravel() for code in codes]),
    )


def _reach_into(view: Region, lower: Floats, upper: Floats) -> NDArray[np.bool_]:
    """Which of these boxes, given by two corners each, meet the view."""
    return np.asarray((lower <= view[2:]).all(axis=1) & (upper >= view[:2]).all(axis=1))


def _draw_paths(axes: Axes, paths: Mapping[str, DrivenPath]) -> list[Line2D]:
    """Every robot's way, from a dot on; the handles are those that the legend has room for."""
    handles = []  # the legend names as many robots as there are colours
    for k, (robot, path) in enumerate(paths.items()):
        x, y = path.line().T
        (line,) = axes.plot(x, y, color=ROBOTS[k % len(ROBOTS)], linewidth=0.7)
        line.set(marker="o", markersize=3.0, markevery=[0], label=f"path of {_shortened(robot, 24)}")
        handles.append(line)
    more = len(handles) - len(ROBOTS)
    if more > 0:
        handles[len(ROBOTS) :] = [Line2D([], [], linestyle="none", label=f"and {more} more")]
    return handles


def _lay_out(figure: Figure, frame: _Frame, name: str, description: str, handles: list[Artist]) -> None:
    """Give everything its place: the title above, the axes, the bar beside them, the legend below."""
    longest = max(len(str(handle.get_label())) for handle in handles)
    columns = min(len(handles), max(1, int((frame.width + _RIGHT) / (0.45 + 0.065 * longest))))
    rows = math.ceil(len(handles) / columns)
    lines = textwrap.wrap(description, round(16 * (frame.width + _RIGHT)))
    bottom, top = 0.55 + _LINE * rows, 0.3 + _LINE * len(lines)
    width, height = _LEFT + frame.width + _RIGHT, bottom + frame.height + top
    figure.set_size_inches(width, height)
    main, bar = figure.axes
    main.set_position((_LEFT / width, bottom / height, frame.width / width, frame.height / height))
    left = _LEFT + frame.width + 0.15
    bar.set_position((left / width, bottom / height, 0.15 / width, frame.height / height))
    x, y = _LEFT / width, bottom + frame.height + 0.1
    title = _shortened(name, round(11 * (frame.width + _RIGHT)))
    figure.text(x, (y + _LINE * len(lines)) / height, title, size=10, weight="bold")
    figure.text(x, y / height, "\n".join(lines))
    figure.legend(handles=handles, ncols=columns, loc="lower left", bbox_to_anchor=(x, 0.08 / height))


def _shortened(name: str, longest: int) -> str:
    shown = printable(name)
    return shown if len(shown) <= longest else f"{shown[: longest - 1]}…"
