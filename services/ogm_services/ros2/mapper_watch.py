"""Mapper watch: whether anybody takes what is sent; said when nobody does, and when one does again."""

import logging
import time
from collections.abc import Callable

from ogm_services.ros2.robots import Robots

LOOK_EVERY = 1.0
"""How often is looked, s."""
UNHEARD = 10.0
"""So long nobody may take anything before it is said, s: a mapper that is started anew takes a moment."""
_NOBODY = (
    "no mapper of map %r takes the robots' poses and scans %s: is `ogm mapper` running there, with --map %s?"
)

log = logging.getLogger(__name__)


class MapperWatch:
    """Tells of a mapper that is not there: at a router, as a robot's own, nothing else would."""

    def __init__(
        self, robots: Robots, map_name: str, where: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """`where` mappers are looked for, in words; `clock` tells s."""
        self._robots, self._map_name, self._where, self._clock = robots, map_name, where, clock
        self._next = 0.0
        self._since: float | None = None
        """Since when nobody takes anything."""
        self._told = False

    def look(self) -> None:
        """Look, if it is time to; called often."""
        now = self._clock()
        if now < self._next:
            return
        self._next = now + LOOK_EVERY
        heard = self._robots.heard
        if heard is None:
            return
        if heard:
            self._since = None
            if self._told:
                log.info("a mapper of map %r takes the robots' poses and scans again", self._map_name)
            self._told = False
            return
        self._since = now if self._since is None else self._since
        if not self._told and now - self._since >= UNHEARD:
            self._told = True
            log.warning(_NOBODY, self._map_name, self._where, self._map_name)
