"""Topics of a bag: which of them make a map, and what to say where they do not."""

from collections.abc import Iterable
from typing import NamedTuple

from ogm_core.errors import BadCdr, BadRecording
from ogm_core.ros2 import cdr
from ogm_core.ros2.bag_files import BagFile, BagTopic
from ogm_core.ros2.bag_folder import listed
from ogm_core.ros2.topics import TF, TF_STATIC, Topic
from ogm_services.ros2.options import matches


class Edge(NamedTuple):
    """A frame's parent, and whether it stands still there."""

    parent: str
    static: bool


class Chosen(NamedTuple):
    """Topics of a bag that are mapped."""

    scans: tuple[BagTopic, ...]
    clouds: tuple[BagTopic, ...]


def edges_in(bag: BagFile) -> dict[str, dict[str, Edge]]:
    """The parents of all frames that a bag's tf names, the last of each, by namespace."""
    found: dict[str, dict[str, Edge]] = {}
    for message in bag.messages([topic for topic in bag.topics if tells_transforms(topic)]):
        edges = found.setdefault(told(message.topic).namespace, {})
        try:
            for edge in cdr.decode_tf_message(bag.cdr(message)):
                edges[edge.child] = Edge(edge.parent, is_static(message.topic))
        except BadCdr:
            continue  # it is counted when it is read for a map
    return found


def chosen_scans(bag: BagFile, globs: tuple[str, ...], cloud_globs: tuple[str, ...]) -> Chosen:
    """The topics of a bag whose scans and clouds are to be mapped; clouds alone, if only these are asked for.

    Raises:
        BadRecording: there are none, or several of which none was asked for; the text names what there is.
    """
    clouds = _asked_for(bag, cdr.POINT_CLOUD2, cloud_globs, "--cloud-topic") if cloud_globs else ()
    if globs:
        return Chosen(_asked_for(bag, cdr.LASER_SCAN, globs, "--scan-topic"), clouds)
    return Chosen((), clouds) if clouds else Chosen(_only_one(bag), ())


def _asked_for(bag: BagFile, kind: str, globs: tuple[str, ...], flag: str) -> tuple[BagTopic, ...]:
    found = [topic for topic in bag.topics if topic.type == kind and topic.messages]
    chosen = tuple(topic for topic in found if matches(topic.name, globs))
    if not chosen:
        there = listed(f"{topic.name} ({topic.messages})" for topic in found)
        raise BadRecording(
            f"{bag.path}: {flag} {', '.join(globs)}: it holds no such {kind.rpartition('/')[2]}; "
            + (f"there are {there}" if there else "there are none")
        )
    return chosen


def _only_one(bag: BagFile) -> tuple[BagTopic, ...]:
    scans = tuple(topic for topic in bag.topics if topic.type == cdr.LASER_SCAN and topic.messages)
    if not scans:
        ours = [f"{topic.name} ({topic.type})" for topic in bag.topics if topic.messages]
        others = [f"{topic.name} ({topic.type}, {topic.encoding})" for topic in bag.others if topic.messages]
        if not ours + others:
            raise BadRecording(f"{bag.path}: holds no message")
        there = f"; there are {listed(ours + others)}"
        clouds = [topic.name for topic in bag.topics if topic.type == cdr.POINT_CLOUD2 and topic.messages]
        instead = f"; --cloud-topic makes scans of {listed(clouds)}" if clouds else ""
        raise BadRecording(f"{bag.path}: holds no LaserScan{there}{instead}")
    if len(scans) > 1:
        found = listed(f"{topic.name} ({topic.messages})" for topic in scans)
        raise BadRecording(f"{bag.path}: holds several LaserScans, say which to map by --scan-topic: {found}")
    return scans


def told(topic: BagTopic) -> Topic:
    """A topic as robots that run tell it."""
    return Topic("dds", topic.name, topic.type)


def tells_transforms(topic: BagTopic) -> bool:
    """Whether a topic carries tf."""
    return topic.type == cdr.TF_MESSAGE and told(topic).last in (TF, TF_STATIC)


def is_static(topic: BagTopic) -> bool:
    """Whether a topic carries the transforms that always hold."""
    return topic.type == cdr.TF_MESSAGE and told(topic).last == TF_STATIC


def has_frame(frames: Iterable[str], name: str) -> bool:
    """Whether a frame is among some, with a prefix or without."""
    return any(frame == name or frame.endswith(f"/{name}") for frame in frames)
