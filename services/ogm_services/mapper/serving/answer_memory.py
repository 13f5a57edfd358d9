"""Memory that answers take: what is being made and sent, and what is kept for the next who asks."""

import sys

from ogm_services.mapper.serving.answer_cache import CACHE_BYTES, Cache
from ogm_services.mapper.serving.large_answers import LargeAnswers
from ogm_services.replies.in_flight import InFlight
from ogm_services.runtime.memory import MemoryUse


class AnswerMemory:
    """What all answers about one map share. Any thread.

    Where memory is short no answer is kept for the next who asks.
    """

    def __init__(self, in_all: MemoryUse | None = None, in_flight: InFlight | None = None) -> None:
        """`in_all`: what else is held, None: there is enough; `in_flight` counts what is made and sent."""
        self.in_all = in_all or MemoryUse(sys.maxsize)
        self.in_flight = in_flight or InFlight()
        self.large = LargeAnswers()
        """Those that are being made, of live and of saved maps together."""
        self.cache_room = self.in_all.share(CACHE_BYTES)
        """Bytes of answers that one cache may keep."""
        self._caches: list[Cache] = []
        self.in_all.add("caches", lambda: self.kept_bytes, let_go=self._let_go)

    def count(self, *caches: Cache) -> None:
        """Count what caches of answers keep, and have them let go of it where it is in the way."""
        self._caches += caches

    @property
    def kept_bytes(self) -> int:
        """Bytes of answers that are kept for the next who asks; a body in two caches counts twice."""
        return sum(cache.nbytes for cache in self._caches)

    def make_room(self) -> None:
        """Have what can be made anew let go, if all together hold more than they may."""
        self.in_all.make_room()

    def _let_go(self) -> None:
        for cache in self._caches:
            cache.let_go()
