"""Words for what is not in a map, and for what helps, wherever a status is shown."""

from collections.abc import Mapping

WHAT_HELPS: Mapping[str, str] = {
    "malformed": "no scan messages: the mapper's log says what is wrong with them",
    "no_pose": "no poses around their stamps: publish poses under the robot's name, steadily, from one clock",
    "duplicate": "their run and seq had come before: give every start of a publisher a run of its own",
    "stale": "older than the robot's oldest kept pose: take all stamps from one clock",
    "overload": "more than the mapper can take: send fewer scans, or map with larger cells",
    "limit": "they would stretch the map past its limits: are their poses and ranges right?",
    "outside": "every beam leaves the map's bounds",
    "superseded": "another publisher has taken over the robot's name: give every robot a name of its own",
    "failed": "a bug of the mapper: its log has the traceback",
    "refused": "of too many robots, or sensors of a robot: use the same names at every start",
}
"""Why scans are dropped, and what to do, by reason."""
LOST_HELPS = (
    "never arrived, and could not be had again: a publisher keeps its newest cache_samples, while it runs"
)
ON_ROBOTS_MEANS = "skipped, as the radius of other robots in the settings says"
HINT_HELPS = "looks wrong: the mapper's log says what, and what to do"
