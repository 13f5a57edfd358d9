"""Common frame of robots on one map: whose poses may be put on it together."""

from ogm_core.errors import NoCommonFrame
from ogm_core.types import Pose


class CommonFrame:
    """Which frame the map is in: that of the first robot, unless settings say where a robot's frame lies.

    `map` is one frame, whoever says it, since robots that are localised in a map share it. Any other, as
    an `odom`, begins where its robot was switched on: no two of them are the same.
    """

    def __init__(self, map_frame: str) -> None:
        self._map_frame = map_frame
        self._robots: dict[str, str] = {}

    def admit(self, robot: str, fixed: str, origin: Pose | None) -> None:
        """Let a robot on the map whose poses are in the frame `fixed`; again whenever that has changed.

        Raises:
            NoCommonFrame: the others' poses are in another one.
        """
        self._robots.pop(robot, None)
        own = self._map_frame if origin is not None or fixed == self._map_frame else f"{fixed} of {robot}"
        other = next((each for each, frame in self._robots.items() if frame != own), None)
        if other is not None:
            theirs = self._robots[other]
            raise NoCommonFrame(
                f"its poses are in {fixed}, those of {other} in {theirs}, and nothing joins the two: run a "
                f"localisation that gives {self._map_frame} -> {fixed}, or say where it lies: --robot "
                f"'{robot}:origin=X,Y,THETA'"
            )
        self._robots[robot] = own
