"""Options of `ogm ros2`, checked."""

import math
from dataclasses import dataclass, field
from fnmatch import fnmatchcase

from ogm_core.errors import BadSetting
from ogm_core.ros2.base_poses import MAP_FRAME, ODOM_FRAME
from ogm_core.ros2.point_cloud import DEFAULT_BINS, Flattening
from ogm_core.ros2.tf_tree import TF_HOLD
from ogm_core.types import Pose
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS

DEFAULT_BAND = (0.1, 1.5)
"""Points between these heights above the base become beams, m."""
MAX_DELAY = 10.0
MAX_TF_HOLD = 60.0


@dataclass(frozen=True, slots=True)
class Ros2Options:
    """Which topics are read, and how; topics are named by globs.

    `pose_topics`: poses come from these, not from tf. `mount`: where the sensors are on the robot, whatever
    tf says; settings of a sensor come before it. `scan_delay` (s) is added to the stamps of scans,
    `tf_hold`: see `TfTree`. LaserScans with more than `max_beams` are malformed.
    """

    scan_topics: tuple[str, ...] = ("*",)
    cloud_topics: tuple[str, ...] = ()
    flattening: Flattening = field(default_factory=lambda: Flattening(*DEFAULT_BAND, DEFAULT_BINS))
    pose_topics: tuple[str, ...] = ()
    mount: Pose | None = None
    tf_hold: float = TF_HOLD
    scan_delay: float = 0.0
    map_frame: str = MAP_FRAME
    odom_frame: str = ODOM_FRAME
    max_beams: int = DEFAULT_MAX_BEAMS

    def __post_init__(self) -> None:
        if not 0.0 <= self.tf_hold <= MAX_TF_HOLD:
            raise BadSetting(f"--tf-hold: 0 to {MAX_TF_HOLD:g} s are needed, got {self.tf_hold:g}")
        if not (math.isfinite(self.scan_delay) and abs(self.scan_delay) <= MAX_DELAY):
            raise BadSetting(f"--scan-delay: -{MAX_DELAY:g} to {MAX_DELAY:g} s, got {self.scan_delay:g}")
        for flag, frame in {"--map-frame": self.map_frame, "--odom-frame": self.odom_frame}.items():
            if not frame or frame.startswith("/"):
                raise BadSetting(f"{flag}: a frame's name without / before it is needed, got {frame!r}")
        for glob in (*self.scan_topics, *self.cloud_topics, *self.pose_topics):
            if not glob.startswith(("/", "*")):
                raise BadSetting(f"{glob!r}: names of topics begin with /, as /scan or /*/scan do")


def matches(name: str, globs: tuple[str, ...]) -> bool:
    """Whether a topic's name matches one of the globs."""
    return any(fnmatchcase(name, glob) for glob in globs)
