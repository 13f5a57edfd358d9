"""Load of a mapper: whether it falls behind its robots."""

import logging
from collections.abc import Callable

HOLD = 10.0
"""How long the queue is more than half full before the mapper counts as behind, and less before not, s."""

log = logging.getLogger(__name__)


class FallingBehind:
    """Whether the work that waits has been more than half of what may wait, for HOLD.

    One thread calls `look`; any may call `reason`.
    """

    def __init__(self, work: Callable[[], float], limit: float) -> None:
        """`work` tells what waits, and `limit` how much may, s of the worker's time."""
        self._work = work
        self._limit = limit
        self._over = False
        self._since = 0.0
        self._behind = False

    def look(self, now: float) -> None:
        """Compare with the look before; `now` in s of any clock that goes on steadily."""
        work = self._work()
        over = work > self._limit / 2
        if over is not self._over:
            self._over, self._since = over, now
        if over is self._behind or now - self._since < HOLD:
            return
        self._behind = over
        if over:
            log.warning(
                "the mapper falls behind: for %g s more than half of the work that may wait has waited, "
                "%.1f s now: send fewer scans or beams, or let the map take less time for them (reach, "
                "clear_range, a larger resolution)",
                *(HOLD, work),
            )
        else:
            log.info("the mapper has caught up")

    def reason(self) -> str | None:
        """Why the mapper should get no more scans than it does; None if it keeps up."""
        return f"the mapper falls behind: {self._work():.1f} s of work wait" if self._behind else None
