"""A square room with walls at +-5.02 m, recordings of robots in it, and how true a map's walls are."""

import json
import math

import numpy as np

S = 10**9
T0 = 1_700_000_000 * S
WALL = 5.02
BEAMS = 360
STEP = math.tau / BEAMS


def ranges(x, y, theta):
    """What a scanner at a pose measures."""
    angles = theta + STEP * np.arange(BEAMS)
    with np.errstate(divide="ignore"):
        to_x = (np.copysign(WALL, np.cos(angles)) - x) / np.cos(angles)
        to_y = (np.copysign(WALL, np.sin(angles)) - y) / np.sin(angles)
    return np.minimum(to_x, to_y).tolist()


def pose(stamp, at, seq, run="a", robot="r1"):
    x, y, theta = at
    fields = {"type": "pose", "robot": robot, "stamp": int(stamp), "seq": seq, "run": run}
    return fields | {"x": x, "y": y, "theta": theta}


def scan(stamp, measured, seq, run="a", robot="r1", **fields):
    message = {"type": "scan", "robot": robot, "sensor": "laser", "stamp": int(stamp), "seq": seq, "run": run}
    message |= {"angle_min": 0.0, "angle_increment": STEP, "range_min": 0.1, "range_max": 30.0}
    return message | {"ranges": measured} | fields


def drive(path, seconds, *, start=T0, poses=20, scans=10, first_pose=0, first_scan=0, run="a"):
    """Messages of a drive, in order: so many poses and scans a second; `path(t)` is the true pose."""
    times = [(n / poses, True) for n in range(seconds * poses + 1)]
    times += [(n / scans, False) for n in range(seconds * scans)]
    messages, seqs = [], [first_scan, first_pose]
    for t, is_pose in sorted(times, key=lambda time: (time[0], not time[1])):
        stamp, seq = start + round(t * S), seqs[is_pose]
        seqs[is_pose] += 1
        messages.append(
            pose(stamp, path(t), seq, run) if is_pose else scan(stamp, ranges(*path(t)), seq, run)
        )
    return messages


def lines(messages):
    """JSON lines."""
    return "".join(json.dumps(message) + "\n" for message in messages)


def astray(npz, tolerance=0.12):
    """(occupied cells farther than that from the room's walls, occupied cells)."""
    iy, ix = np.nonzero(npz["log_odds"] > math.log(0.65 / 0.35))
    resolution, (x, y) = float(npz["resolution"]), npz["origin"]
    wall = np.maximum(abs(x + (ix + 0.5) * resolution), abs(y + (iy + 0.5) * resolution))
    return int((abs(wall - WALL) > tolerance).sum()), ix.size
