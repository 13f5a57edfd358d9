"""Placing state: whoever goes on from it, at any message, does what an uninterrupted placer does."""

import random
import struct
from collections import Counter
from itertools import islice

import pytest

from journeys import DOUBTFUL, SAFE, Journey
from mapper_desk import MS, T0, Desk, Sink
from ogm_core.placing.state import StateParts, state_of
from ogm_core.types import Pose


class BitSink(Sink):
    """Keeps every bit of what it is handed beside the scan."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def integrate(self, scan, pose, sweep=None):
        along = None if sweep is None else (struct.pack("3d", *sweep.middle), sweep.beams.tobytes())
        self.calls.append((struct.pack("3d", *pose), along))
        return super().integrate(scan, pose, sweep)


class Life:
    """Lives of a mapper, one after the other; each goes on from what the one before has stored."""

    def __init__(self, parts=()):
        self.desk = Desk(BitSink())
        self.stored = dict(parts)
        state = state_of(self.stored)
        self.desk.placer.restore(state)
        self.writer = StateParts(self.desk.placer.state())

    def hand(self, n, entry):
        """Message n of all robots' journeys: a robot's name and its message."""
        desk, (robot, (kind, run, *rest)) = self.desk, entry
        if kind == "gone":
            desk.placer.robot_gone(robot, run)
            return
        seq, stamp, *rest = rest
        at = (stamp - T0) // MS
        if kind == "pose":
            desk.pose(at, Pose(*rest[0]), run=run, seq=seq, robot=robot)
        else:
            sensor, beams = rest
            desk.scan(
                *(at,),
                seq=seq,
                run=run,
                robot=robot,
                sensor=sensor,
                tag=n,
                beams=len(beams),
                time_increment=(beams[1] - beams[0]) / 1e9,
            )

    def store(self):
        """Put what has changed of the state into the parts that are stored."""
        for key, value in self.writer.changes(self.desk.placer.state()).items():
            if value is None:
                del self.stored[key]
            else:
                self.stored[key] = value
        return self.stored

    @property
    def undecided(self):
        """Numbers of the messages that wait."""
        waiting = [item.scan for robot in self.desk.placer._robots.values() for item in robot.waiting]
        return sorted(self.desk._tags[scan] for scan in waiting)

    @property
    def placed(self):
        """Every call to the sink: which message, and where, bit for bit."""
        return list(zip(self.desk.tags, self.desk.sink.calls, strict=True))


def uninterrupted(messages):
    life = Life()
    for n, message in enumerate(messages):
        life.hand(n, message)
    return life.placed, Counter(life.desk.dropped)


def interrupted(messages, cuts, looks):
    """The same of lives that end at the cuts; the state is stored at each cut, and at looks, too."""
    life, placed, dropped = Life(), [], Counter()
    for n, message in enumerate(messages):
        life.hand(n, message)
        if n in looks:
            life.store()
        if n in cuts:
            parts, again = life.store(), life.undecided
            placed, dropped = placed + life.placed, dropped + Counter(life.desk.dropped)
            life = Life(parts)
            for m in again:
                life.hand(m, messages[m])
    return placed + life.placed, dropped + Counter(life.desk.dropped)


def check(messages, seed):
    rng = random.Random(seed)
    wanted = uninterrupted(messages)
    for count in (1, 1, 5, 40):
        cuts = set(rng.sample(range(len(messages)), count))
        looks = set(rng.sample(range(len(messages)), 20))
        assert interrupted(messages, cuts, looks) == wanted
    return len(wanted[0])


@pytest.mark.parametrize("kind", [*SAFE, *DOUBTFUL])
def test_who_goes_on_from_a_state_does_what_who_was_not_interrupted_does(kind):
    for seed in range(4):
        check([("r", message) for message in Journey(kind, seed).messages], seed)


def test_many_robots_go_on_from_their_states():
    rng, kinds = random.Random(1), [*SAFE, *DOUBTFUL]
    for seed in range(4):
        journeys = {f"r{n}": iter(Journey(rng.choice(kinds), seed).messages) for n in range(4)}
        messages = []
        while journeys:
            name = rng.choice(list(journeys))
            messages += [(name, message) for message in islice(journeys[name], rng.randrange(1, 9))] or [None]
            if messages[-1] is None:
                messages.pop()
                del journeys[name]
        assert check(messages, seed) > 100
