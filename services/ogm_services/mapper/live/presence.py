"""Presence of robots, as a log tells of it: who has come, and who has gone and why."""

import logging
from collections.abc import Callable, Mapping

from ogm_core.placing.receipts import Presence
from ogm_core.status import GONE_AFTER

MAX_LINES = 10
"""Robots that come or go between two looks have a line each; more than that share one."""
SAYS_NOT = "it does not say any more that it is alive"

log = logging.getLogger(__name__)


class RobotPresence:
    """Logs robots that come and go, as far as one look differs from the one before.

    A robot comes with its liveliness token, or with its first message if it has none. It goes with its token,
    or when it has been silent for GONE_AFTER. A message after that brings it back.
    """

    def __init__(self, present: Callable[[], Mapping[str, Presence]]) -> None:
        """`present` tells of every robot that is known."""
        self._present = present
        self._here: dict[str, bool] = {}
        """Robots that are here: whether they say so by a token."""
        self._heard_last: dict[str, float | None] = {}
        """Of robots whose token has gone: when they were heard last."""

    def look(self, now: float) -> None:
        """Compare with the look before; `now` in s of the clock that messages are stamped with on arrival."""
        present = self._present()
        came, went = [], []
        for name, robot in present.items():
            reason = self._why_gone(name, robot, now)
            if reason is None and name not in self._here:
                came.append(f"robot {name} came")
            if reason is None:
                self._here[name] = robot.alive
                self._heard_last.pop(name, None)
            elif self._here.pop(name, None) is not None:
                went.append(f"robot {name} went: {reason}")
        for name in self._here.keys() - present.keys():  # forgotten at once: it was never heard
            del self._here[name]
            went.append(f"robot {name} went: {SAYS_NOT}")
        for name in self._heard_last.keys() - present.keys():
            del self._heard_last[name]
        _tell(came, "came")
        _tell(went, "went")

    def _why_gone(self, name: str, robot: Presence, now: float) -> str | None:
        """Why a robot is not here; None if it is."""
        if robot.alive:
            return None
        if self._here.get(name):
            self._heard_last[name] = robot.heard
        if name in self._heard_last and robot.heard == self._heard_last[name]:
            return SAYS_NOT
        if robot.heard is None or now - robot.heard > GONE_AFTER:
            return f"it has been silent for {GONE_AFTER:g} s"
        return None


def _tell(lines: list[str], what: str) -> None:
    for line in lines[:MAX_LINES]:
        log.info("%s", line)
    if len(lines) > MAX_LINES:
        log.info("and %d more robots %s", len(lines) - MAX_LINES, what)
