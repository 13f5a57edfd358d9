"""Caches of one robot: whether they are there, and whether they answer when they are asked."""

from collections.abc import Mapping

from ogm_services.mapper.intake.held_source import HeldSource

AWAY = 10.0
"""A robot whose caches go may come back within that, s: its scans wait for their poses meanwhile."""
SILENT = 20.0
"""A robot whose caches are there and do not answer is asked for so long, s, before what it misses is lost."""
SETTLING = 0.1
"""A robot's caches come one after the other: it is asked when so long none has come, s."""


class RobotCaches:
    """What is known of the caches of all of a robot's sources. Times, s, are of one clock."""

    def __init__(self, sources: Mapping[str | None, HeldSource]) -> None:
        """`sources` are the robot's, by sensor, None for its poses: there may be more of them later."""
        self._sources = sources
        self.back = 0.0
        """Until when it may come back, if some have gone."""
        self.unanswered = False
        """Whether they did not answer when they were asked last."""
        self.answered: set[str | None] | None = None
        """Sensors, None for poses, whose caches had something when asked last; None: not all answered."""
        self._silent_since = 0.0
        """When they did not for the first time in a row."""
        self._changed = 0.0
        """When the last one came."""

    def note(self, known: HeldSource, cache: str, here: bool, now: float) -> None:
        """Note that a cache of a source is there, or gone."""
        if here:
            self._changed = now
            known.caches.add(cache)
            known.had_cache = True
            known.none_of = None
        else:
            known.caches.discard(cache)
            self.back = now + AWAY

    def note_answered(self, answered: bool, now: float) -> None:
        """Note whether all that were asked have answered."""
        if not answered and not self.unanswered:
            self._silent_since = now
        self.unanswered = not answered

    def may_come_back(self, now: float) -> bool:
        """Whether a source's caches are gone, but not for long: its publisher may be on its way back."""
        sources = list(self._sources.values())
        return now < self.back and any(known.had_cache and not known.caches for known in sources)

    def may_answer(self, now: float) -> bool:
        """Whether they are there and did not answer, but not for long: they may just be slow."""
        sources = list(self._sources.values())
        return self.unanswered and now < self._silent_since + SILENT and any(each.caches for each in sources)

    def is_settling(self, now: float) -> bool:
        """Whether one came within SETTLING: others may come yet."""
        return now - self._changed < SETTLING
