"""The slow, obvious twin of skipping other robots: every robot has the twin of a placer, asked beam by beam.

Messages are those of `naive_placing`, each with its robot's name; of scans `readings` says, by message
number, where each beam that is a hit ends in its sensor's frame, None for others.
"""

import math

from naive_placing import MS, Placing


def last_said(twin, stamp):
    """Where a robot was at a stamp, as far as its twin has heard; None if it cannot say."""
    if not twin.poses:
        return None
    pose, (newest, there) = twin.pose_at(stamp), twin.poses[-1]
    if pose is None and abs(stamp - newest) <= 500 * MS and newest not in twin.ambiguous:
        return there
    return pose


def newest(twin):
    return (twin.provisional or twin.poses[-1])[0]


class Robots:
    """Of each scan that was placed its message's number, and how far beyond every radius its hits end."""

    def __init__(self, radii, readings):
        self.radii, self.readings = radii, readings
        self.twins, self.messages, self.placed = {}, {}, []

    def play(self, messages):
        for number, (robot, message) in enumerate(messages):
            twin = self.twins.setdefault(robot, Placing())
            mine = self.messages.setdefault(robot, [])
            mine.append((number, message))
            done = len(twin.placed)
            twin.play([message])
            for own_number, _ in twin.placed[done:]:
                at, scan = mine[own_number]
                self.placed.append((at, self.beyond(robot, at, scan)))
        return self

    def beyond(self, robot, number, scan):
        """How far every beam's end lies beyond the nearest robot's radius, m: negative if it is skipped."""
        own = self.twins[robot]
        stamps, found = scan[5], []
        for stamp, end in zip(stamps, self.readings[number], strict=True):
            nearest = math.inf
            for other, twin in self.twins.items():
                if other == robot or end is None or not twin.poses or other not in self.radii:
                    continue
                if abs(newest(twin) - newest(own)) > 1000 * MS:
                    continue
                there = last_said(twin, stamp)
                x, y, theta = own.pose_at(stamp)
                ex = x + end[0] * math.cos(theta) - end[1] * math.sin(theta)
                ey = y + end[0] * math.sin(theta) + end[1] * math.cos(theta)
                if there is not None:
                    away = math.hypot(ex - there[0], ey - there[1])
                    nearest = min(nearest, away - self.radii[other])
            found.append(nearest)
        return found
