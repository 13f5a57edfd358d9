"""Memory of a live map: how much it may hold beside all else of a mapper, and the copies that readers get."""

import math
import time
from collections.abc import Callable

from ogm_core.errors import SMALLER_MAP, LimitReached
from ogm_services.runtime.memory import MemoryUse

LOOK_PERIOD = 0.05
"""How old a figure of the memory that is left may be, s, while much is."""
_GOOD_PART = 8


class MapMemory:
    """What a map may hold of the memory that all have together: its writer's."""

    def __init__(self, use: MemoryUse, copies: Callable[[], int]) -> None:
        """`copies`: bytes that copies of the map hold now."""
        self._use = use
        self._copies = copies
        self._looked = -math.inf, 0
        """When it was added up what the map may hold, s, and what that is, bytes."""

    def allowed(self, held: int) -> int:
        """Bytes that the map, which has `held` so far, may hold now, beside all else and a copy of it.

        While a good part of all memory is left to it, this is added up a few times a second only.
        """
        looked, allowed = self._looked
        now = time.monotonic()
        if now - looked > LOOK_PERIOD or allowed - held < self._use.limit // _GOOD_PART:
            copies = self._copies()
            left = self._use.left() + held + copies
            # A new copy takes up to a quarter more than its tiles.
            allowed = min(left - copies, left * 4 // 9)
            self._looked = now, allowed
        return allowed

    def refusal(self) -> LimitReached:
        """What who is refused for lack of it is told."""
        return LimitReached(
            f"it needs new tiles, and of mapper.max_memory, {self._use.limit} bytes, too little is left "
            f"({self._use.in_words()}; readers need a copy of the map): raise it, {SMALLER_MAP}",
            "max_memory",
        )
