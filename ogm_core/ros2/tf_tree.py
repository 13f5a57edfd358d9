"""A robot's tf tree: which frame is where in which other one, at a time.

A lookup walks up from a frame, since every frame has one parent but may have many children, as `odom` has
`base_link` and `base_footprint`. What is missing is an error that names it, never the identity.
"""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from ogm_core.errors import MAX_SHOWN, BadMessage, NoTransform, NoTransformYet, cut, printable
from ogm_core.placing.rules import POSE_GAP
from ogm_core.ros2.cdr import StampedTransform
from ogm_core.ros2.tf_history import LATE_NS, TfHistory
from ogm_core.ros2.transform import IDENTITY, Transform, unit

TF_HOLD = 1.0
"""For so long past its newest sample an edge holds that may be held, s."""
MAX_FRAMES = 4096
"""Frames with a parent, of all robots of one /tf together; others are refused."""
MAX_FRAME_NAME = 256
_FRAMES_SHOWN = 20


class Complaint(NamedTuple):
    """What is wrong with a transform: `what` is a word of `TfTree.counts`, the text names both frames."""

    what: str
    text: str


class TfTree:
    """What one robot's /tf and /tf_static have said, in whatever order.

    Of static edges the newest holds, whoever sends it. A frame whose parent changes, or that becomes static
    or moves after all, forgets where it was. `counts` tells what was refused ("no_name", "own_parent",
    "bad_transform", "too_many_frames") or unusual: "reparented", "reordered" (a sample came after a later
    one), "repeated" (a stamp, whose first sample stays), "restarted" (a clock went back).
    """

    def __init__(self, *, pose_gap: float = POSE_GAP, tf_hold: float = TF_HOLD) -> None:
        """`pose_gap`: samples farther apart say nothing of the time between, s, unless nearly equal.

        `tf_hold`: how long an edge holds that may be held, s; 0: none is.
        """
        self.counts: Counter[str] = Counter()
        self._gap_ns, self._hold_ns = pose_gap * 1e9, tf_hold * 1e9
        self._edges: dict[str, TfHistory] = {}
        """By the child's name."""
        self._paths: dict[str, tuple[str, ...]] = {}
        """From frames that were asked for up to their roots, as long as nothing changes."""

    @property
    def frames(self) -> list[str]:
        """The names of all frames, sorted."""
        return sorted({name for child, edge in self._edges.items() for name in (child, edge.parent)})

    def add(self, transforms: Iterable[StampedTransform], *, static: bool = False) -> list[Complaint]:
        """Take in a message of /tf, or of /tf_static; what is to be said of it."""
        edges, complaints = self._edges, list[Complaint]()
        for stamp, parent, child, given in transforms:
            try:
                transform = unit(given)
            except BadMessage as error:
                complaints.append(self._complaint("bad_transform", parent, child, str(error)))
                continue
            edge: TfHistory | None = edges.get(child)
            if edge is None or edge.parent != parent or edge.static != static:
                complaint = self._new_edge(edge, parent, child, static)
                if complaint is not None:
                    complaints.append(complaint)
                edge = edges.get(child)
                if edge is None or edge.parent != parent:
                    continue
            unusual = edge.add(stamp, transform)
            if unusual is not None:
                self.counts[unusual] += 1
            if unusual == "restarted":
                self._restart_above(parent, stamp)
        return complaints

    def path(self, frame: str) -> tuple[str, ...]:
        """The frames from `frame` up to its root, both included.

        Raises:
            NoTransform: the way up goes round in a loop; the text names it.
        """
        path = self._paths.get(frame)
        if path is None:
            path = self._walk(frame)
            if frame in self._edges:
                self._paths[frame] = path
        return path

    def edge(self, child: str) -> TfHistory | None:
        """What is known of where a frame is in its parent."""
        return self._edges.get(child)

    def anchor(self, fixed: str, frame: str) -> str | None:
        """The lowest frame from `frame` up that moves in its parent, below `fixed`; None if none does."""
        for child in self._below(fixed, frame):
            if not self._edges[child].static:
                return child
        return None

    def lookup(self, fixed: str, frame: str, stamp: int, *, anchor: str | None = None) -> Transform:
        """Where `frame` is in `fixed` at `stamp` (ns): every edge interpolated, and all composed, in 3D.

        Edges above that of `anchor`, as map->odom is above odom->base, hold for `tf_hold` past their newest
        sample; without one, none does. No edge is extrapolated.

        Raises:
            NoTransformYet: an edge is missing so far, or its newest sample is too old.
            NoTransform: there is a loop, or `stamp` lies before an edge's oldest sample, or in a gap.
        """
        if frame == fixed:
            return IDENTITY
        hold_ns, found = 0.0, IDENTITY
        for child in self._below(fixed, frame):
            edge = self._edges[child]
            try:
                found = edge.at(stamp, self._gap_ns, hold_ns).compose(found)
            except NoTransform as error:
                text = f"{_from_to(frame, fixed)}: {_shown(edge.parent)} -> {_shown(child)}: {error}"
                raise type(error)(text, error.kind) from None
            if child == anchor:
                hold_ns = self._hold_ns
        return found

    def _new_edge(self, old: TfHistory | None, parent: str, child: str, static: bool) -> Complaint | None:
        """Give a frame its place in the tree, from now on; what is wrong with that."""
        if not (0 < len(parent) <= MAX_FRAME_NAME and 0 < len(child) <= MAX_FRAME_NAME):
            text = f"names of frames have 1 to {MAX_FRAME_NAME} characters"
            return self._complaint("no_name", parent, child, text)
        if parent == child:
            return self._complaint("own_parent", parent, child, "a frame cannot be its own parent")
        if old is None and len(self._edges) >= MAX_FRAMES:
            return self._complaint("too_many_frames", parent, child, f"{MAX_FRAMES} frames are kept")
        self._paths.clear()
        self._edges[child] = TfHistory(parent, static=static)
        if old is None or old.parent == parent:
            return None
        text = f"its parent was {_shown(old.parent)} before; a frame has one: do two nodes publish it?"
        return self._complaint("reparented", parent, child, text)

    def _complaint(self, what: str, parent: str, child: str, text: str) -> Complaint:
        self.counts[what] += 1
        return Complaint(what, f"{_shown(parent)} -> {_shown(child)}: {text}")

    def _restart_above(self, frame: str, stamp: int) -> None:
        """Forget what moving edges from a frame up told before the clock below went back to `stamp`."""
        seen: set[str] = set()
        while (edge := self._edges.get(frame)) is not None and frame not in seen:
            seen.add(frame)
            if not edge.static and edge.newest is not None and edge.newest > stamp + LATE_NS:
                edge.restart()
            frame = edge.parent

    def _below(self, fixed: str, frame: str) -> tuple[str, ...]:
        """The frames from `frame` up to the one whose parent is `fixed`."""
        path = self.path(frame)
        if fixed in path:
            return path[: path.index(fixed)]
        if len(path) == 1:
            why = f"no tf says where {_shown(frame)} is"
        else:
            why = f"tf leads up from it to {_shown(path[-1])} only"
        raise NoTransformYet(f"{_from_to(frame, fixed)}: {why}; {self._listed()}", "no edge")

    def _walk(self, frame: str) -> tuple[str, ...]:
        path: dict[str, None] = {frame: None}
        while (edge := self._edges.get(frame)) is not None:
            frame = edge.parent
            if frame in path:
                names = [*path]
                loop = [*names[names.index(frame) :], frame]
                text = " -> ".join(map(_shown, loop[:_FRAMES_SHOWN]))
                raise NoTransform(f"tf goes round in a loop: {text}", "loop")
            path[frame] = None
        return tuple(path)

    def _listed(self) -> str:
        frames = self.frames
        if not frames:
            return "no tf has come yet"
        more = f" and {len(frames) - _FRAMES_SHOWN} more" if len(frames) > _FRAMES_SHOWN else ""
        return f"there are {', '.join(map(_shown, frames[:_FRAMES_SHOWN]))}{more}"


def _shown(name: str) -> str:
    if not name:
        return "'' (empty)"
    return cut(printable(name)) if len(name) > MAX_SHOWN or not name.isprintable() else name


def _from_to(frame: str, fixed: str) -> str:
    return f"no transform from {_shown(frame)} to {_shown(fixed)}"
