"""Troubled journeys of several robots that see each other: the placer skips what its naive twin skips."""

import math
import random

import numpy as np
import pytest

from journeys import DOUBTFUL, SAFE, Journey
from mapper_desk import T0, Desk
from naive_placing import MS
from naive_robots import Robots
from ogm_core.grid_settings import GridSettings
from ogm_core.sensor_models.hits import hits_at_robots
from ogm_core.types import Pose

SEED = 3
BEAMS = 24
APART = 1.2
"""How far apart the robots' ways are, m."""
RADII = {"a": 0.6, "b": 0.9}
"""Nobody knows how large c is."""
KINDS = [*SAFE, *DOUBTFUL]


def fleet(kind, seed):
    """Messages of three robots in order of arrival, each with its robot's name; of one clocks may differ."""
    rng = random.Random(f"{kind} {seed}")
    kinds = kind, rng.choice(KINDS), "quiet"
    entries = []
    for n, (robot, each) in enumerate(zip("abc", kinds, strict=True)):
        journey, off = Journey(each, seed + n), rng.choice([0, 0, 0, 0, 300, -700, 1500]) * MS
        for arrival, message, _ in journey.entries:
            if message[0] == "gone":
                continue
            _, run, seq, stamp, *rest = message
            if message[0] == "pose":
                x, y, theta = rest[0]
                rest = [(x, y + n * APART, theta)]
            else:
                period = rest[1][1] - rest[1][0]
                rest = [rest[0], [stamp + off + k * period for k in range(BEAMS)]]
            entries.append((arrival, robot, (message[0], run, seq, stamp + off, *rest)))
    entries.sort(key=lambda entry: entry[0])
    return [entry[1:] for entry in entries]


def measured(messages, seed):
    """Ranges of every scan, by message number: hits, and beams that are none."""
    rng = np.random.default_rng(seed)
    found = {}
    for number, (_, message) in enumerate(messages):
        if message[0] == "scan":
            ranges = rng.uniform(0.2, 3.0, BEAMS).astype(np.float32)
            ranges[rng.random(BEAMS) < 0.1] = rng.choice([np.nan, np.inf, 0.0, 7.97, 8.0])
            found[number] = ranges
    return found


def end_of(k, r):
    """Where a beam that is a hit ends in its sensor's frame; None of another."""
    if not 0.0 < r < 8.0 - 0.05:
        return None
    return float(r) * math.cos(k * 0.26), float(r) * math.sin(k * 0.26)


def skipped_by_desk(messages, ranges):
    """Message numbers of the placed scans, in order, and which of their beams are no reading any more."""
    desk = Desk(radii=RADII, mark_hits=hits_at_robots(GridSettings()))
    for number, (robot, (kind, run, seq, stamp, *rest)) in enumerate(messages):
        ms = (stamp - T0) // MS
        if kind == "pose":
            desk.pose(ms, Pose(*rest[0]), run=run, seq=seq, robot=robot)
        else:
            increment = (rest[1][1] - rest[1][0]) / 1e9
            fields = {"time_increment": increment, "angle_increment": 0.26, "ranges": ranges[number]}
            desk.scan(ms, seq=seq, run=run, robot=robot, sensor=rest[0], tag=number, **fields)
    desk.placer.finish()
    return [(tag, np.isnan(scan.ranges)) for tag, scan in zip(desk.tags, desk.sink.scans, strict=True)], desk


@pytest.mark.parametrize("kind", KINDS)
def test_the_placer_skips_what_its_twin_skips(kind):
    messages = fleet(kind, SEED)
    ranges = measured(messages, SEED)
    readings = {number: [end_of(k, r) for k, r in enumerate(each)] for number, each in ranges.items()}
    twin = Robots(RADII, readings).play(messages)
    found, desk = skipped_by_desk(messages, ranges)
    assert [tag for tag, _ in found] == [number for number, _ in twin.placed]
    skipped = kept = 0
    for (number, nan), (_, beyond) in zip(found, twin.placed, strict=True):
        new = nan & ~np.isnan(ranges[number])
        sure = np.abs(beyond) > 1e-7
        assert (new[sure] == (np.array(beyond)[sure] < 0.0)).all(), number
        skipped += np.count_nonzero(new)
        kept += np.count_nonzero(~new)
    assert skipped > 0 < kept
    assert desk.receipts.status().scans.beams_on_robots == skipped
