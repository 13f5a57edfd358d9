"""Troubled journeys: whatever clocks, networks and publishers do, no scan is placed where it was not taken.

The scan placer agrees with its naive twin, scan by scan, on every kind of trouble. Of the kinds from which a
wrong place could be told, none is placed wrong.
"""

import math

import pytest

from journeys import DOUBTFUL, SAFE, Journey
from mapper_desk import T0, Desk
from naive_placing import MS, Placing
from ogm_core.types import Pose


def placed_by_desk(journey, **rules):
    """Desk after a journey, its scans tagged with the numbers of their messages."""
    desk = Desk(**rules)
    for n, message in enumerate(journey.messages):
        if message[0] == "gone":
            desk.placer.robot_gone("r", message[1])
            continue
        kind, run, seq, stamp, *rest = message
        if kind == "pose":
            desk.pose((stamp - T0) // MS, Pose(*rest[0]), run=run, seq=seq)
        else:
            increment = (rest[1][1] - rest[1][0]) / 1e9
            desk.scan(
                (stamp - T0) // MS, seq=seq, run=run, beams=3, time_increment=increment, sensor=rest[0], tag=n
            )
    desk.placer.finish()
    return desk


@pytest.mark.parametrize("kind", [*SAFE, *DOUBTFUL])
def test_the_placer_is_its_twin(kind):
    for seed in range(3):
        journey = Journey(kind, seed)
        desk, twin = placed_by_desk(journey), Placing().play(journey.messages)
        assert desk.tags == [n for n, _ in twin.placed]
        for (_, got), (_, wanted) in zip(desk.sink.placed, twin.placed, strict=True):
            assert got == pytest.approx(wanted, abs=1e-9)
        counts = {}
        for reason in twin.dropped.values():
            counts[reason] = counts.get(reason, 0) + 1
        assert desk.dropped == counts
        poses = desk.receipts.status().poses
        assert {name: getattr(poses, name) for name in twin.notes} == twin.notes


def astray(journey, desk):
    """How far each placed scan is from where it was taken, m."""
    return [
        math.dist(pose[:2], journey.truth[n][:2])
        for n, (_, pose) in zip(desk.tags, desk.sink.placed, strict=True)
    ]


@pytest.mark.parametrize("kind", SAFE)
def test_nothing_is_placed_wrong(kind):
    placed = 0
    for seed in range(100, 112):
        journey = Journey(kind, seed)
        desk = placed_by_desk(journey)
        far = astray(journey, desk)
        assert max(far, default=0.0) < 0.1, (seed, journey.step)
        placed += len(far)
    assert placed > 0
