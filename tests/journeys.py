"""Troubled journeys of a robot: whatever clocks, networks and publishers do to its poses and scans."""

import math
import random

from mapper_desk import T0
from naive_placing import MS

SAFE = (
    *("quiet", "step forward", "late pose", "late scan", "repeated pose", "repeated scan", "repeated burst"),
    *(
        "outliers",
        "jump",
        "restart",
        "restart as another run",
        "poses in steps",
        "stands",
        "one stamp",
        "whole seconds",
    ),
    *("step back", "two steps back", "step back without runs", "step back without seqs"),
    "step back with outliers",
)
"""Nothing may be placed wrong. Clocks step back by more than a period of the scans and their delay."""
DOUBTFUL = (
    *("poses step back", "scans step back", "poses step forward", "scans step forward", "two publishers"),
    *("owner leaves", "pose from elsewhen", "scan from elsewhen", "outliers nearby", "outliers in pairs"),
    "restart of the clock",
)
"""No rule can tell which clock is right, which of two robots is meant, or that the robot was not there."""
STEPS = (0.1, 0.3, 0.5, 0.8, 1, 2, 3, 5, 30, 1000)


def where(t):
    return 0.8 * t, 0.5 * math.sin(t), 0.3 * t


def elsewhere(kind, start, t):
    if kind == "stands":  # from 4 s to 9 s
        t = min(t, 4.0) + max(t - 9.0, 0.0)
    x, y, theta = where(t)
    return (x + 2.1, y - 1.0, theta) if kind == "jump" and t >= start else (x, y, theta)


def offset(kind, is_pose, step, start, t):
    """By how much the clock is off, s."""
    if t < start:
        return 0.0
    if kind == "two steps back":
        return -step * (1 + (t >= start + 1.5))
    sides = {"poses": is_pose, "scans": not is_pose}
    if kind.split()[0] in sides and not sides[kind.split()[0]]:
        return 0.0
    if "step back" in kind or kind == "restart of the clock":
        return -step
    return step if "step forward" in kind else 0.0


def clocked(kind, t):
    if kind == "one stamp":
        return T0
    return T0 + (math.floor(t) * 1000 * MS if kind == "whole seconds" else round(t * 1000) * MS)


class Journey:
    """12 s of a robot's messages, some of them troubled; `truth` of the scans, by message number."""

    def __init__(self, kind, seed):
        self.rng = random.Random(f"{kind} {seed}")
        self.kind = kind
        self.start = self.rng.uniform(3.0, 8.0)
        self.entries = []  # (arrival, message, truth)
        self.runs = self.rng.choice([("A", "A"), ("A", "B")])
        if kind == "step back without runs":
            self.runs = ("", "")
        self.sensors = self.rng.choice(["s", "st"])
        self.seqs = {}
        self.drive()
        self.trouble()
        self.messages = [message for _, message, _ in self.entries]
        self.truth = {n: at for n, (_, message, at) in enumerate(self.entries) if message[0] == "scan"}

    def drive(self):
        pose_rate, scan_rate = self.rng.choice([10, 20, 50]), self.rng.choice([5, 10, 40])
        delay = self.rng.choice([0.0, 0.05, 0.2])
        self.step = self.rng.choice([step for step in STEPS if step > 1.4 / scan_rate + delay])
        times = [(n / pose_rate + self.rng.uniform(0, 0.2) / pose_rate, True) for n in range(12 * pose_rate)]
        times += [
            (n / scan_rate + self.rng.uniform(0, 0.4) / scan_rate, False) for n in range(12 * scan_rate)
        ]
        begun_anew = False
        for t, is_pose in sorted(times):
            if self.kind.startswith("restart") and t >= self.start and not begun_anew:
                begun_anew, self.seqs = True, {}
                if self.kind == "restart as another run":
                    self.runs = tuple(run + "2" for run in self.runs)
            stamp = clocked(self.kind, t + offset(self.kind, is_pose, self.step, self.start, t))
            at = elsewhere(self.kind, self.start, t)
            self.put(t if is_pose else t + delay, is_pose, stamp, at)
            other = self.kind == "two publishers" or (self.kind == "owner leaves" and t < self.start + 2)
            if other and t >= self.start:
                self.put(t, is_pose, stamp + 3 * MS, (at[0] + 30.0, *at[1:]), ("Z", "Z"))
        if self.kind == "owner leaves":
            self.entries.append((self.start + 2, ("gone", "Z"), None))
        self.entries.sort(key=lambda entry: entry[0])

    def put(self, arrival, is_pose, stamp, at, runs=None):
        pose_run, scan_run = runs or self.runs
        key = "pose" if is_pose else self.rng.choice(self.sensors)
        seq = 0 if self.kind == "step back without seqs" else self.seqs.get((key, runs), 0)
        self.seqs[key, runs] = seq + 1
        if is_pose:
            self.entries.append((arrival, ("pose", pose_run, seq, stamp, at), None))
        else:
            period = self.rng.choice([0, 0, 4 * MS])
            beams = [stamp + n * period for n in range(3)]
            self.entries.append((arrival, ("scan", scan_run, seq, stamp, key, beams), at))

    def chosen(self, which, share):
        return [
            n for n, entry in enumerate(self.entries) if entry[1][0] == which and self.rng.random() < share
        ]

    def trouble(self):
        kind, rng, entries = self.kind, self.rng, self.entries
        which = "scan" if "scan" in kind else "pose"
        if kind.startswith("late"):
            for n in self.chosen(which, 0.04):
                entries.insert(min(len(entries), n + rng.randrange(1, 8)), entries.pop(n))
        elif kind == "repeated burst":
            n, count = rng.randrange(80, len(entries)), rng.randrange(3, 80)
            entries[n:n] = entries[n - count : n]
        elif kind.startswith("repeated"):
            for n in reversed(self.chosen(which, 0.05)):
                entries.insert(min(len(entries), n + rng.randrange(1, 10)), entries[n])
        elif "outliers" in kind:
            self.wrong_poses(0.3 if "nearby" in kind else 5.0, 4.0 if "nearby" in kind else 500.0)
        elif kind.endswith("elsewhen"):
            for n in self.chosen(which, 0.01):
                off = rng.choice([-1, 1]) * round(rng.choice([0.2, 1, 10, 1e6]) * 1000) * MS
                arrival, message, at = entries[n]
                moved = list(message)
                moved[3] += off
                if which == "scan":
                    moved[5] = [beam + off for beam in moved[5]]
                entries[n] = arrival, tuple(moved), at
        elif kind in ("poses in steps", "stands"):
            self.thin_out()

    def wrong_poses(self, least, most):
        for n in self.chosen("pose", 0.03):
            angle, far = self.rng.uniform(0, math.tau), self.rng.uniform(least, most)
            twice = [m for m in range(n + 1, len(self.entries)) if self.entries[m][1][0] == "pose"][:1]
            for m in [n, *(twice if "pairs" in self.kind else [])]:
                arrival, (*rest, (x, y, theta)), at = self.entries[m]
                moved = (x + far * math.cos(angle), y + far * math.sin(angle), theta)
                self.entries[m] = arrival, (*rest, moved), at

    def thin_out(self):
        """Leave a pose every 0.25 m, as AMCL does."""
        last, kept = None, []
        for entry in self.entries:
            if entry[1][0] == "pose":
                x, y, _ = entry[1][4]
                if last is not None and math.hypot(x - last[0], y - last[1]) < 0.25:
                    continue
                last = x, y
            kept.append(entry)
        self.entries[:] = kept
