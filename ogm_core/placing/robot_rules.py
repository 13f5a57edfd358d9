"""Robot rules: what is known of robots that their messages do not say."""

from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase

from ogm_core.placing.rules import MAX_ROBOTS


@dataclass(frozen=True, slots=True)
class RobotRule:
    """What holds for the robots that `match`, a glob on their names.

    `radius`: what other robots see of it lies within that of its pose, m; None: nothing is known of it.
    """

    match: str
    radius: float | None = None


class RobotRules:
    """The radii of robots: of each that of the first rule that matches and has one."""

    def __init__(self, rules: Iterable[RobotRule] = ()) -> None:
        self._rules = [rule for rule in rules if rule.radius is not None]
        self._radii: dict[str, float | None] = {}
        self._matched: set[str] = set()

    def __bool__(self) -> bool:
        """Whether any robot may have a radius."""
        return bool(self._rules)

    @property
    def unmatched(self) -> list[str]:
        """The globs that no robot has matched yet."""
        return [rule.match for rule in self._rules if rule.match not in self._matched]

    def radius_of(self, robot: str) -> float | None:
        """The radius of a robot, m; None if no rule says."""
        if robot not in self._radii:
            if len(self._radii) >= MAX_ROBOTS:
                self._radii.clear()
            matching = [rule for rule in self._rules if fnmatchcase(robot, rule.match)]
            self._matched.update(rule.match for rule in matching)
            self._radii[robot] = matching[0].radius if matching else None
        return self._radii[robot]
