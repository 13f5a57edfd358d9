"""A status, and what JSON says of it or of its parts."""

import json

from ogm_core.status import (
    MapInfo,
    OtherCounts,
    PoseCounts,
    RobotStatus,
    ScanCounts,
    SourceStatus,
    Status,
    encode_status,
)
from ogm_core.types import Pose

NO_POSES = dict.fromkeys(
    (
        *("received", "malformed", "late", "restarted", "ambiguous", "outlier", "superseded", "refused"),
        *("lost", "replayed"),
    ),
    0,
)
"""The counts of poses of a mapper that has had none."""

STATUS = Status(
    map="hall",
    epoch="e1",
    run="r1",
    revision=41,
    stamp=1_700_000_000_500_000_001,
    scans=ScanCounts(
        received=50,
        integrated=41,
        pending=2,
        dropped={"malformed": 0, "no_pose": 7},
        lost=8,
        replayed=9,
        beams_on_robots=12,
    ),
    poses=PoseCounts(
        received=60,
        malformed=1,
        late=3,
        restarted=2,
        ambiguous=4,
        outlier=5,
        superseded=6,
        refused=7,
        lost=10,
        replayed=11,
    ),
    other=OtherCounts(ignored=5),
    map_info=MapInfo(known_cells=1234, bytes=2_500_000, width=400, height=300, resolution=0.05),
    robots={
        "r2": RobotStatus(
            Pose(1.0, -2.5, 0.1),
            7,
            alive=True,
            age_s=0.25,
            sources={
                "front": SourceStatus(
                    run="a",
                    last_seq=None,
                    received=40,
                    pending=2,
                    integrated=33,
                    dropped={"no_pose": 5},
                    hints=["range_max"],
                    lost=8,
                    beams_on_robots=13,
                )
            },
        ),
        "r1": RobotStatus(None, None),
    },
    uptime_s=12.25,
    restored=False,
)


def as_json(part):
    return json.loads(encode_status(part))
