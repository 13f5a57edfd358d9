"""Save a running mapper's map for ROS 2 nav2: NAME.yaml and, beside it, NAME.pgm.

python examples/export_to_nav2.py --out office.yaml
ros2 run nav2_map_server map_server --ros-args -p yaml_filename:=office.yaml
"""

import argparse
import sys

from ogm_client import DEFAULT_ADDRESS, MapClient, OgmError


def main() -> None:
    """Fetch the map, or a part of it, and write the two files."""
    parser = argparse.ArgumentParser(description="Save a running mapper's map for nav2's map_server.")
    parser.add_argument("--url", default=DEFAULT_ADDRESS, help="tcp/HOST:PORT or http://HOST:PORT")
    parser.add_argument("--map", default="default", help="name of the map")
    parser.add_argument("--out", default="map.yaml", help="file to write; its picture comes to lie beside it")
    parser.add_argument(
        "--region", nargs=4, type=float, metavar=("XMIN", "YMIN", "XMAX", "YMAX"), help="a part of it, m"
    )
    options = parser.parse_args()

    with MapClient(options.url, map_name=options.map) as mapper:
        grid = mapper.get_map(options.region)
    grid.save_ros_map(options.out)
    print(f"{options.out}: {grid.width} x {grid.height} cells, revision {grid.revision}")


if __name__ == "__main__":
    try:
        main()
    except (OgmError, OSError) as error:
        sys.exit(f"export_to_nav2: {error}")
