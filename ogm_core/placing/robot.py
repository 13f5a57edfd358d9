"""All that is known of one robot, and what of it can be let go where robots hold too much memory."""

from dataclasses import dataclass, field

from ogm_core.placing.held import Held
from ogm_core.placing.robot_poses import RobotPoses
from ogm_core.placing.source import Source
from ogm_core.placing.waiting import WaitingScans

MAX_GONE = 64
"""So many runs that are gone are remembered of a robot."""


@dataclass(slots=True)
class Robot:
    """All that decides where the scans of one robot go."""

    held: Held
    """What its poses, and the seqs and runs of its scans, take in memory."""
    poses: RobotPoses
    waiting: WaitingScans
    """Until a pose at or after their last beam arrives."""
    sources: dict[str, Source] = field(default_factory=dict)
    pose_heard: float = 0.0
    gone: dict[str, None] = field(default_factory=dict)
    """Runs whose liveliness token was there and is no more, the last one at the end."""

    def note_gone(self, run: str) -> None:
        """Remember a run that is gone."""
        self.gone[run] = None
        if len(self.gone) > MAX_GONE:
            del self.gone[next(iter(self.gone))]

    def lighten(self) -> str:
        """Let go of what it can do without, long histories first; what that was, "" if there is nothing."""
        history = self.poses.history
        before, count = self.held.nbytes, len(history)
        if history.shorten():
            return f"of its {count} poses the newest {len(history)} are kept"
        for source in self.sources.values():
            source.forget_most()
        if self.held.nbytes < before:
            return (
                "of each of its sensors the last run is kept, and all seqs before its last one count as seen"
            )
        return ""
