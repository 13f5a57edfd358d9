"""Services of ROS 2: the one that is offered over Zenoh, nav_msgs/GetMap."""

from ogm_core.ros2.topics import Qos

GET_MAP = "nav_msgs/srv/GetMap"
GET_MAP_HASH = "RIHS01_c8ae77c9995b3554b5ba80e4d4d443f970ac65143102a1d893ec24fc07b31147"
"""Of the type; from Iron on all distributions have the same."""
QOS = Qos(reliable=True, transient_local=False, depth=10)
"""As all services of ROS 2 have it, unless told otherwise."""


def get_map_service(topic: str) -> str:
    """The name of the service that gives the map of a topic: /ogm/get_map beside /ogm/map."""
    return f"{topic.rpartition('/')[0]}/get_map"
