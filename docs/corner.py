"""Draws docs/corner.png: the same corner of the office, in a map of log odds and in one that counts.

`make pictures` makes both maps of one log, and says in which folders they are and where the picture goes.
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

from ogm_client import MapGrid

CORNER = 25.0, 1.5, 30.5, 6.5
"""A meeting room with tables, chairs and a cupboard: xmin, ymin, xmax, ymax, m."""
TITLES = "log odds, cells of 0.05 m", "rate, cells of 0.025 m"


def main(*folders: str, picture: str) -> None:
    """Draw the maps of these two folders side by side."""
    figure = Figure(figsize=(8.0, 3.9), layout="constrained")
    xmin, ymin, xmax, ymax = CORNER
    for axes, folder, title in zip(figure.subplots(1, 2, sharey=True), folders, TITLES, strict=True):
        MapGrid.load(Path(folder, "map.npz")).plot(axes)
        axes.set(xlim=(xmin, xmax), ylim=(ymin, ymax), title=title)
        axes.set_axis_off()
    figure.savefig(picture, dpi=100, pil_kwargs={"optimize": True}, metadata={"Software": None})


if __name__ == "__main__":
    main(*sys.argv[1:3], picture=sys.argv[3])
