"""Follow a running mapper and plot its map, live: in a window, or into a picture that is written anew.

python examples/subscribe_and_plot.py                   # till the window is closed
python examples/subscribe_and_plot.py --out live.png    # till Ctrl-C

Needs matplotlib: pip install 'zenoh-ogm[plot]'.
"""

import argparse
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from io import BytesIO
from itertools import islice
from pathlib import Path

from matplotlib import pyplot as plt

from ogm_client import DEFAULT_ADDRESS, MapClient, MapGrid, OgmError

INTERVAL = 0.2
"""How often the mapper is asked whether its map has changed, s."""


def draw(grid: MapGrid) -> None:
    """Draw a map into the figure, in metres; origin, size and revision in the title."""
    axes = plt.gca()
    axes.clear()
    axes.set_title(f"{grid.width} x {grid.height} cells of {grid.resolution:g} m, revision {grid.revision}")
    if grid.log_odds.size:
        grid.plot(axes)


def save(grids: Iterator[MapGrid], out: str) -> None:
    """Write each map into the picture `out`, at once: a viewer, or Ctrl-C, meets no half of one."""
    new = Path(f"{out}.new")
    for grid in grids:
        draw(grid)
        picture = BytesIO()
        plt.savefig(picture, format=Path(out).suffix[1:])
        new.write_bytes(picture.getvalue())
        new.replace(out)


def show(grids: Iterator[MapGrid], waiting: ThreadPoolExecutor) -> None:
    """Draw each map in a window until it is closed; the window stays awake while the map does not change."""
    window = plt.figure()
    window.show()
    coming = waiting.submit(next, grids, None)
    while plt.fignum_exists(window.number):
        if coming.done():
            grid = coming.result()
            if grid is None:
                return
            draw(grid)
            window.canvas.draw_idle()
            coming = waiting.submit(next, grids, None)
        window.canvas.start_event_loop(INTERVAL)


def main() -> None:
    """Follow the map until the asked number of revisions, the end of the window, or Ctrl-C."""
    parser = argparse.ArgumentParser(description="Plot a running mapper's map, live.")
    parser.add_argument("--url", default=DEFAULT_ADDRESS, help="tcp/HOST:PORT or http://HOST:PORT")
    parser.add_argument("--map", default="default", help="name of the map")
    parser.add_argument("--out", help="a picture to write, .png or .svg, instead of a window")
    parser.add_argument("--revisions", type=int, help="end after so many different maps")
    options = parser.parse_args()
    if options.revisions is not None and options.revisions < 1:
        parser.error("--revisions: 1 or more is needed")
    if options.out and not options.out.endswith((".png", ".svg")):
        parser.error("--out: a name that ends in .png or .svg is needed")
    if options.out:
        plt.switch_backend("agg")
    elif plt.get_backend().lower() == "agg":
        sys.exit("subscribe_and_plot: no window can be opened here: give --out FILE.png")

    # The mapper's connection is closed first: that ends a thread that still waits for a change.
    with ThreadPoolExecutor(1) as waiting, MapClient(options.url, map_name=options.map) as mapper:
        grids = islice(mapper.watch(INTERVAL), options.revisions)
        if options.out:
            save(grids, options.out)
        else:
            show(grids, waiting)


if __name__ == "__main__":
    try:
        with suppress(KeyboardInterrupt):
            main()
    except (OgmError, OSError) as error:
        sys.exit(f"subscribe_and_plot: {error}")
