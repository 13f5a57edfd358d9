"""What a log is read with, whatever its format: a name for its one robot, and a longest range."""

from dataclasses import replace
from pathlib import Path

from ogm_core.errors import BadRecording, BadSetting
from ogm_core.logs.recorded import Recorded
from ogm_core.wire.keys import check_name
from ogm_core.wire.messages import MAX_RANGE


class Renaming:
    """Gives a log's one robot another name; None: robots are called as the log says.

    Raises:
        BadSetting: it is no robot's name.
    """

    def __init__(self, path: Path, robot: str | None) -> None:
        if robot is not None:
            check_name(robot, "robot")
        self._path = path
        self._new_name = robot
        self._old_name: str | None = None

    def of(self, recorded: Recorded) -> Recorded:
        """A message under its robot's name.

        Raises:
            BadRecording: it is of a second robot.
        """
        if self._new_name is None:
            return recorded
        if self._old_name is None:
            self._old_name = recorded.robot
        if recorded.robot != self._old_name:
            raise BadRecording(
                f"{self._path}: holds robots {self._old_name} and {recorded.robot}; --robot renames one "
                "robot only, so leave it out or split the log"
            )
        return replace(recorded, robot=self._new_name)


def check_range_max(range_max: float | None) -> None:
    """Refuse a `range_max` that no scan can have.

    Raises:
        BadSetting: it is one.
    """
    if range_max is not None and not 0.0 < range_max <= MAX_RANGE:
        raise BadSetting(f"range-max: above 0 and at most {MAX_RANGE:g} m is needed, got {range_max:g}")
