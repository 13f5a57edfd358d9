"""Layout file: which topics Foxglove and Lichtblick show, as both import it; without one they show none."""

import json
from collections.abc import Mapping
from typing import Any

from ogm_core.ros2.mcap_recording import MAP_FRAME
from ogm_core.status import RobotStatus
from ogm_services.foxglove.map_channel import TOPIC
from ogm_services.foxglove.robot_channels import ROBOTS, TF, scan_topic

_PANEL = "3D!ogm"
_POINT_SIZE = 4
_DISTANCE = 40.0
"""Of the camera from the floor, m: what is seen is about as high."""


def layout(robots: Mapping[str, RobotStatus]) -> str:
    """JSON of a 3D panel that looks down on the map, the robots, and the scans of those that are there."""
    scans = [
        scan_topic(name, sensor)
        for name, robot in sorted(robots.items())
        if not robot.gone
        for sensor in sorted(robot.sources)
    ]
    shown: dict[str, dict[str, Any]] = {TF: {}, TOPIC: {"colorMode": "map", "drawBehind": True}, ROBOTS: {}}
    shown |= {topic: {"pointSize": _POINT_SIZE, "colorMode": "flat"} for topic in scans}
    panel = {
        "followTf": MAP_FRAME,
        "followMode": "follow-none",
        "cameraState": {
            "perspective": False,
            "distance": _DISTANCE,
            "phi": 0.0,
            "thetaOffset": 0.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.5,
            "far": 5000.0,
        },
        "scene": {},
        "transforms": {},
        "layers": {},
        "topics": {topic: {"visible": True, **settings} for topic, settings in shown.items()},
    }
    whole = {
        "configById": {_PANEL: panel},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _PANEL,
    }
    return json.dumps(whole, indent=2) + "\n"
