"""A robot's poses from its tf: one of its base at each time at which tf says where that moved to."""

from collections import Counter
from dataclasses import dataclass

from ogm_core.errors import NoTransform, NoTransformYet
from ogm_core.ros2.tf_history import SPAN_NS
from ogm_core.ros2.tf_tree import TfTree
from ogm_core.types import Pose

MAP_FRAME = "map"
ODOM_FRAME = "odom"


@dataclass(frozen=True, slots=True)
class RobotFrames:
    """The frames of a robot: `fixed`, in which its poses are, and `base`, which they are of.

    `odometry`: there is no map frame, and poses are what its wheels say.
    """

    fixed: str
    base: str
    odometry: bool


def robot_frames(
    tree: TfTree, sensor: str, *, map_frame: str = MAP_FRAME, odom_frame: str = ODOM_FRAME
) -> RobotFrames:
    """The frames that a sensor's way up the tree goes by: up to `map_frame`, or else to `odom_frame`.

    The base is the frame below `odom_frame`; without one on the way, the topmost that moves. A name matches
    with a prefix, too, as `robot1/odom` does.

    Raises:
        NoTransformYet: tf leads up to neither of them so far; the text names the frames that there are.
        NoTransform: the way up goes round in a loop.
    """
    path = tree.path(sensor)
    at_map, at_odom = _named(path[1:], map_frame), _named(path[1:], odom_frame)
    fixed = at_map or at_odom
    if fixed is None:
        tree.lookup(map_frame, sensor, 0)  # says what is missing
        return RobotFrames(map_frame, sensor, False)  # the sensor's frame itself is the map's
    below = path[: path.index(fixed)]
    if at_odom is not None and at_odom in (*below, fixed):
        base = path[path.index(at_odom) - 1]
    else:
        base = next((child for child in reversed(below) if not _static(tree, child)), below[-1])
    return RobotFrames(fixed, base, fixed == at_odom)


class BasePoses:
    """Poses of one robot's base in the fixed frame, in the order of their stamps, as a mapper wants them.

    There is one at each sample of the lowest edge that moves, which is odom->base, the fastest; those above,
    as map->odom, are interpolated, or held for `tf_hold`. A sample that comes after a later one was given
    gives none. `counts` tells why other samples gave none: "oldest" (before all samples of a slower edge),
    "gap" (in one).
    """

    def __init__(self, tree: TfTree, frames: RobotFrames) -> None:
        self.counts: Counter[str] = Counter()
        self._tree, self._frames = tree, frames
        self._last: int | None = None
        self._restarts = 0
        self._missing = ""

    def take(self) -> list[tuple[int, Pose]]:
        """The poses that can be told by now and were not given yet, with their stamps, ns.

        Those wait for which a slower edge is still missing; while frames are missing there are none.
        """
        tree, fixed, base = self._tree, self._frames.fixed, self._frames.base
        try:
            anchor = tree.anchor(fixed, base)
        except NoTransform as error:
            self._missing = str(error)
            return []
        edge = None if anchor is None else tree.edge(anchor)
        if edge is None or edge.newest is None:
            return []
        if edge.restarts > self._restarts or (self._last is not None and edge.newest < self._last - SPAN_NS):
            self._last = None
        self._restarts = edge.restarts
        found = []
        for stamp in edge.stamps_after(self._last):
            try:
                found.append((stamp, tree.lookup(fixed, base, stamp, anchor=anchor).planar()))
            except NoTransformYet as error:
                self._missing = str(error)
                break
            except NoTransform as error:
                self._missing = str(error)
                self.counts[error.kind] += 1
            else:
                self._missing = ""
            self._last = stamp
        return found

    @property
    def missing(self) -> str:
        """Why there are no poses after those that were given."""
        fixed, base = self._frames.fixed, self._frames.base
        if self._missing:
            return self._missing
        if self._last is None:
            return f"every transform from {base} up to {fixed} is static, so none says when it was there"
        return f"no transform that says where {base} moves to has come since"


def _named(path: tuple[str, ...], name: str) -> str | None:
    if name in path:
        return name  # what a map is called that is common to all, even where it is above a prefixed one
    return next((frame for frame in path if frame.endswith(f"/{name}")), None)


def _static(tree: TfTree, child: str) -> bool:
    edge = tree.edge(child)
    return edge is None or edge.static
