"""A node of ROS 2 that answers nav_msgs/GetMap with the map that `ogm ros2 --publish-map` publishes.

python3 examples/ros2_get_map.py --topic /ogm/map
ros2 service call /ogm/get_map nav_msgs/srv/GetMap

For robots on DDS, where `ogm ros2` itself offers no service. It runs where ROS 2 does, with ROS 2's Python.
"""

import argparse
import copy

import rclpy
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

LATCHED = QoSProfile(
    depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL
)
"""Who comes late gets the last message."""


class MapServer(Node):
    """Keeps the last whole map with the last update of it, and gives that to who asks; no cells before it."""

    def __init__(self, topic: str) -> None:
        super().__init__("ogm_get_map")
        self.whole, self.update, self.map = OccupancyGrid(), OccupancyGridUpdate(), OccupancyGrid()
        self.create_subscription(OccupancyGrid, topic, self.take_whole, LATCHED)
        self.create_subscription(OccupancyGridUpdate, f"{topic}_updates", self.take_update, LATCHED)
        self.create_service(GetMap, f"{topic.rpartition('/')[0]}/get_map", self.answer)

    def take_whole(self, message: OccupancyGrid) -> None:
        """A new whole map; the last update may be of it, and may have come first, if it is newer."""
        self.whole = self.map = message
        if stamp_of(self.update) > stamp_of(message):
            self.take_update(self.update)

    def take_update(self, message: OccupancyGridUpdate) -> None:
        """What differs from the last whole map, from the cell (x, y) on: it takes the last update's place."""
        self.update = message
        width, height = self.whole.info.width, self.whole.info.height
        if message.x + message.width > width or message.y + message.height > height:
            return  # of a map that comes yet
        self.map = copy.copy(self.whole)
        cells = self.whole.data[:]
        for row in range(message.height):
            begin = (message.y + row) * width + message.x
            cells[begin : begin + message.width] = message.data[
                row * message.width : (row + 1) * message.width
            ]
        self.map.data = cells
        self.map.header = message.header

    def answer(self, _: GetMap.Request, reply: GetMap.Response) -> GetMap.Response:
        """The map of this moment."""
        reply.map = self.map
        return reply


def stamp_of(message: OccupancyGrid | OccupancyGridUpdate) -> tuple[int, int]:
    """Seconds and nanoseconds of a message's stamp."""
    return message.header.stamp.sec, message.header.stamp.nanosec


def main() -> None:
    """Answer until Ctrl-C."""
    parser = argparse.ArgumentParser(description="Answer nav_msgs/GetMap with a map that is published.")
    parser.add_argument("--topic", default="/ogm/map", help="where `ogm ros2 --publish-map` publishes it")
    options = parser.parse_args()
    rclpy.init()
    try:
        rclpy.spin(MapServer(options.topic))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
