"""Reasons in words: why a scan is dropped or a pose not believed, and what helps."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from ogm_core.placing.rules import FORGOTTEN_AFTER, MAX_ROBOTS, MAX_SENSORS, MAX_WAITING_SCANS, WAITING_NS
from ogm_core.placing.source import REPEATS_IN_A_ROW
from ogm_core.types import Pose, shorter_arc
from ogm_core.units import MEBIBYTE


class Reason(NamedTuple):
    """What a user is told; of each kind and source the first is told in any case."""

    kind: str
    text: str


_YEAR_NS = 31_536_000_000_000_000
_TWO = "two publishers under one name? Give every robot a name of its own"
_RATE = "do poses come at a steady rate, while the robot stands, too, with stamps from the scans' clock?"

SEEN = Reason(
    "duplicate", "a scan of this run and seq has come before, or is older than all that are remembered"
)
RENUMBERED = Reason(
    "renumbered",
    f"{REPEATS_IN_A_ROW} scans in a row have the run and seqs of scans before, with new stamps: the run's "
    "numbering has begun anew. Give each start of a publisher a run of its own",
)
LOG_ENDED = Reason("log ended", f"the log ends before a pose at or after its last beam: {_RATE}")
CROWDED = Reason(
    "crowded",
    f"no pose has come for it, and scans of its sensor that are {WAITING_NS / 1e9:g} s newer, or "
    f"{MAX_WAITING_SCANS} others, wait, too: {_RATE}",
)
STEPPED = Reason(
    "stepped",
    "the clock of its sensor went back before its pose came; if that happens again and again, look at "
    "that clock",
)
FORGOTTEN = Reason("forgotten", f"its robot is gone for {FORGOTTEN_AFTER:g} s")

BEYOND = Reason(
    "beyond",
    "one of its beams was taken before the oldest pose that is kept: is its time_increment in seconds?",
)
AMBIGUOUS = Reason(
    "beside ambiguous",
    "a pose beside it has the stamp of another, different pose, so nobody knows which one holds: give "
    "every pose the time at which it was true, in ns",
)


def stale(by_ns: int) -> Reason:
    """A scan is older than the poses."""
    return Reason(
        "stale",
        f"its stamp lies {by_ns / 1e9:g} s before the oldest pose that is kept of its robot: let poses and "
        f"scans have their stamps from one clock, or give the sensor a time_offset{_other_unit(by_ns)}",
    )


def gap(between_ns: int, pose_gap_ns: float) -> Reason:
    """The poses around a scan are too far apart in time."""
    return Reason(
        "gap",
        f"it lies between two poses {between_ns / 1e9:g} s apart, and mapper.pose_gap is "
        f"{pose_gap_ns / 1e9:g} s: publish poses more often, or raise mapper.pose_gap if the robot drives "
        "straight on between two poses",
    )


def too_much_waits(cells: float) -> Reason:
    """The scans of a robot that wait would take too long once they are ready, all at once."""
    return Reason(
        "too much waits",
        f"no pose has come for it yet, and scans of this robot that speak of {cells:.2g} cells wait already: "
        f"{_RATE}",
    )


def no_room(share: float) -> Reason:
    """Scans that wait hold too much memory."""
    return Reason(
        "no room",
        f"no pose has come for it yet, and scans that wait for poses hold their share of memory, "
        f"{share / MEBIBYTE:.3g} MiB, those of this robot the most of it: {_RATE}",
    )


def holds_the_most(share: float, what: str) -> Reason:
    """What robots hold is too much, and one of them holds the most of it."""
    return Reason(
        "holds the most",
        f"poses, runs and seqs of all robots hold their share of memory, {share / MEBIBYTE:.3g} MiB, those "
        f"of this robot the most of it: {what}. Do its stamps rise by 60 s a minute, and its seqs by one a "
        "message?",
    )


def too_many_robots(robot: str) -> Reason:
    """A robot is one too many."""
    return Reason(
        "too many robots",
        f"messages of robot {robot} are refused: {MAX_ROBOTS} others are alive, or were alive or "
        f"heard within {FORGOTTEN_AFTER:g} s; do robots change their names?",
    )


def too_many_sensors(sensor: str) -> Reason:
    """A sensor is one too many for its robot."""
    return Reason(
        "too many sensors",
        f"scans of sensor {sensor} are refused: its robot has {MAX_SENSORS} others; do sensors change their "
        "names?",
    )


def no_pose_ever(robot: str, others: Sequence[str]) -> Reason:
    """No pose has come under the name of a scan's robot."""
    of_others = f" (there are poses of {', '.join(others)})" if others else ""
    return Reason(
        "no pose ever",
        f"no pose of robot {robot} has ever come{of_others}: publish its poses under this name, or put a "
        "pose into each of its scans",
    )


def began_anew(why: str) -> Reason:
    """A new history of poses began while a scan waited; `why` says when."""
    return Reason(
        f"began: {why.partition(' (')[0]}",
        f"a new history of its robot's poses began before its pose came, because {why}; if that happens "
        "again and again, look at what is said of its robot's poses",
    )


def superseded_scan(run: str, heir: str) -> Reason:
    """A run of scans that another one has replaced."""
    return Reason("superseded", f"run {run!r} was replaced by run {heir!r}: {_TWO}")


def superseded_pose(run: str, owner: str) -> Reason:
    """A run of poses that another one has replaced."""
    return Reason(
        "superseded", f"poses of run {run!r} are refused, because run {owner!r} has replaced it: {_TWO}"
    )


def waited(pose_wait: float) -> Reason:
    """A scan has waited for as long as it may, s."""
    return Reason(
        "waited", f"no pose at or after its last beam came within mapper.pose_wait = {pose_wait:g} s: {_RATE}"
    )


def ahead(by_ns: int, pose_wait: float) -> Reason:
    """A scan is too far ahead of its robot's poses."""
    return Reason(
        "ahead",
        f"its stamp is {by_ns / 1e9:g} s ahead of the robot's newest pose, more than mapper.pose_wait = "
        f"{pose_wait:g} s: send poses while the robot stands, too (AMCL does not), and let poses and scans "
        f"have their stamps from one clock, or give the sensor a time_offset{_other_unit(by_ns)}",
    )


def _other_unit(apart_ns: int) -> str:
    return "; so far apart, one of the two is not in ns" if apart_ns > _YEAR_NS else ""


def sensor_clock_went_back(by_ns: int) -> Reason:
    """A sensor's stamps step back."""
    return Reason(
        "stepped back",
        f"the clock of this sensor went back by {by_ns / 1e9:g} s: its scans wait for the robot's next "
        "pose, with which a new history begins. If the poses' clock did not go back, set both from one "
        "clock, or give the sensor a time_offset",
    )


def late(by_ns: int) -> Reason:
    """A pose is earlier than the one before it."""
    return Reason("late", f"a pose is {by_ns / 1e9:g} s earlier than the one before it, and is not used")


REPEATED_POSE = Reason("late", "a pose has the stamp of the one before it, and says the same")


def clock_went_back(by_ns: int) -> Reason:
    """The stamps of a robot's poses step back."""
    return Reason(
        "restarted",
        f"the clock of its poses went back by {by_ns / 1e9:g} s: a new history of poses begins, scans of "
        "the time before are placed no more. If no clock was set and no simulation restarted, give each "
        "publisher a name of its own",
    )


def ambiguous(stamp: int) -> Reason:
    """Two different poses have one stamp."""
    return Reason(
        "ambiguous",
        f"two different poses have the stamp {stamp}, so no scan is placed beside them: stamps repeat. "
        "Give every pose the time at which it was true, in ns (are they whole seconds, or never set?)",
    )


def jumped(way: str) -> Reason:
    """Poses lie where no robot gets, and stay there; `way` is that of `way_between`."""
    return Reason(
        "jumped",
        f"its poses jumped ({way}), farther than mapper.max_speed and mapper.max_turn_rate allow: a new "
        "history of poses begins. If that was no correction of its localisation, raise them",
    )


def outlier(way: str) -> Reason:
    """One pose lies where no robot gets."""
    return Reason(
        "outlier",
        f"a pose is dropped, no robot gets there ({way}; see mapper.max_speed, mapper.max_turn_rate)",
    )


def contradiction(way: str) -> Reason:
    """Poses lie to and fro where no robot gets."""
    return Reason("contradiction", f"poses contradict each other ({way}): headings in degrees, or {_TWO}")


def way_between(t0: int, p0: Pose, t1: int, p1: Pose) -> str:
    """How far two poses are apart, as "2.1 m and 1.5 rad within 0.1 s"; stamps in ns."""
    far, turn = math.hypot(p1.x - p0.x, p1.y - p0.y), abs(shorter_arc(p0.theta, p1.theta))
    return f"{far:.3g} m and {turn:.3g} rad within {(t1 - t0) / 1e9:.3g} s"
