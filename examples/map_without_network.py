"""A map of arrays, without a mapper and without network: poses and ranges in, a picture out.

python examples/map_without_network.py --out room.png

Replace `readings` by your own. Needs the whole of zenoh-ogm: zenoh-ogm-client makes no maps.
"""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence

from ogm_client import MapGrid, OgmError
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.types import Pose
from ogm_core.wire.values import scan_of

BEAMS = 360
STEP = math.tau / BEAMS
HALF_LENGTH, HALF_WIDTH = 3.02, 2.02
"""The room's walls lie so far from its middle, m."""
DOOR = (1.0, 2.0)
"""From and to which x, m, the wall in the north is open."""


def map_of(readings: Iterable[tuple[Pose, Sequence[float]]]) -> MapGrid:
    """The map of what a LiDAR has measured, m, along BEAMS bearings from -pi on, at poses of its own."""
    grid = OccupancyGrid(GridSettings(resolution=0.05))
    for pose, ranges in readings:  # a list of ranges does, an array as well; inf where nothing was met
        scan = scan_of(ranges, angle_min=-math.pi, angle_increment=STEP, range_min=0.1, range_max=5.0)
        grid.integrate(scan, pose)
    return MapGrid.from_snapshot(grid.snapshot())


def readings() -> Iterator[tuple[Pose, list[float]]]:
    """Eleven poses along the room, and the distances to its walls from there."""
    for step in range(11):
        x, y, theta = pose = Pose(-2.0 + 0.4 * step, 0.5 * math.sin(step), 0.3 * step)
        bearings = [theta - math.pi + STEP * beam for beam in range(BEAMS)]
        yield pose, [to_the_wall(x, y, math.cos(bearing), math.sin(bearing)) for bearing in bearings]


def to_the_wall(x: float, y: float, dx: float, dy: float) -> float:
    """Distance, m, from the point (x, y) in the room to its walls along (dx, dy); inf out of the door."""
    along_x = (math.copysign(HALF_LENGTH, dx) - x) / dx if dx else math.inf
    along_y = (math.copysign(HALF_WIDTH, dy) - y) / dy if dy else math.inf
    if along_y < along_x and dy > 0 and DOOR[0] < x + along_y * dx < DOOR[1]:
        return math.inf
    return min(along_x, along_y)


def main() -> None:
    """Make the map and draw it."""
    parser = argparse.ArgumentParser(description="Make a map of poses and ranges, without network.")
    parser.add_argument("--out", default="map.png", help="the picture to write")
    options = parser.parse_args()

    room = map_of(readings())
    room.save_png(options.out)
    print(f"{options.out}: {room.width} x {room.height} cells, of {room.revision} scans")


if __name__ == "__main__":
    try:
        main()
    except (OgmError, OSError) as error:
        sys.exit(f"map_without_network: {error}")
