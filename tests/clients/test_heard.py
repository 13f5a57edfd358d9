"""Whether a mapper has heard of what a publisher sends: when `feedback` complains, and when it does not."""

import pytest

from ogm_client.heard import UNHEARD, UNHEARD_BEHIND, Sent
from ogm_core.status import RobotStatus, SourceStatus
from ogm_core.types import Pose

RATE = 10.0


@pytest.fixture
def sent():
    """`sent(seconds, ...)`: ten messages a second, of a run each, one after the other, from 0 s on."""

    def send(*legs):
        sent, now = Sent(), 0.0
        for run, seconds in legs:
            for seq in range(round(seconds * RATE)):
                sent.note(run, seq, now)
                now += 1.0 / RATE
        return sent

    return send


def robot(run="", last_seq=None, received=0, pending=0):
    source = SourceStatus(run, last_seq, received, pending, integrated=received - pending)
    return RobotStatus(None, None, age_s=0.1, sources={"laser": source})


NOTHING = RobotStatus(None, None)


@pytest.mark.parametrize(
    ("seconds", "status", "unheard"),
    [
        (2.5, NOTHING, False),  # not long enough to say
        (4.0, NOTHING, True),
        (4.0, robot("mine", 39, 40), False),
        (4.0, robot("mine", 20, 21), False),  # a little late
        (20.0, robot("mine", 20, 21), True),  # heard at first, and no more
        (4.0, robot("another", 500, 501), True),
        (4.0, robot("", None, 40), False),  # heard, but none could be read: the counts say that
        (6.0, robot("another", 500, 600, pending=99), False),  # far behind: its turn may yet come
        (12.0, robot("another", 500, 600, pending=99), True),
    ],
)
def test_scans(sent, seconds, status, unheard):
    assert sent(("mine", seconds)).unheard(status, "laser", 100.0, seconds) is unheard


@pytest.mark.parametrize("sensor", ["laser", None])
def test_a_mapper_that_has_just_started_may_not_have_heard_yet(sent, sensor):
    scans = sent(("mine", 9.0))
    assert not scans.unheard(NOTHING, sensor, UNHEARD - 0.1, 9.0)
    assert scans.unheard(NOTHING, sensor, UNHEARD + 0.1, 9.0)


def test_poses(sent):
    poses = sent(("mine", 4.0))
    assert poses.unheard(NOTHING, None, 100.0, 4.0)
    assert not poses.unheard(RobotStatus(None, None, age_s=0.1), None, 100.0, 4.0)
    assert not poses.unheard(RobotStatus(Pose(0.0, 0.0, 0.0), 1), None, 100.0, 4.0)  # of an older mapper


def test_a_pause_is_no_silence_of_the_mapper(sent):
    scans = sent(("mine", 4.0))
    assert not scans.unheard(robot("mine", 39, 40), "laser", 100.0, 60.0)
    scans.note("mine", 40, 60.0)
    assert not scans.unheard(robot("mine", 39, 40), "laser", 100.0, 60.0 + UNHEARD - 0.1)
    assert scans.unheard(robot("mine", 39, 40), "laser", 100.0, 60.0 + UNHEARD)


def test_recorded_runs_one_after_the_other_are_each_heard(sent):
    scans = sent(("a", 4.0), ("b", 2.0))
    assert not scans.unheard(robot("b", 15, 56), "laser", 100.0, 6.0)
    assert scans.unheard(robot("c", 15, 56), "laser", 100.0, 6.0)


def test_what_is_kept_is_little_and_enough(sent):
    scans = sent(("mine", 1000.0))
    assert len(scans._samples) < 30
    assert scans.unheard(robot("another", 1, 1, pending=1), "laser", 5000.0, 1000.0)
    assert UNHEARD_BEHIND > UNHEARD
