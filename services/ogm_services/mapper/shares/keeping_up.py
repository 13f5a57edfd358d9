"""Keeping up: gathers again and again, so that followers are told, and missing shares are noticed."""

import logging
import threading
import time
from collections.abc import Callable

from ogm_services.mapper.shares.gathering import Gathering
from ogm_services.runtime.limited_log import LimitedLog

PERIOD = 0.1
"""Between two gatherings while somebody follows, at least, s."""
IDLE = 1.0
"""Between two while nobody does, s."""

log = logging.getLogger(__name__)


class KeepingUp:
    """Gathers on a thread of its own. Started once, stopped once."""

    def __init__(self, gathering: Gathering, asked: Callable[[], float]) -> None:
        """`asked` tells when the map was last looked at by who follows it, s of the monotonic clock."""
        self._gathering = gathering
        self._asked = asked
        self._complaints = LimitedLog(log)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ogm-gathering")

    @property
    def alive(self) -> bool:
        """Whether it gathers."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the gathering in hand, and end."""
        self._stopping.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        gathered = -IDLE
        while not self._stopping.wait(PERIOD):
            followed = time.monotonic() - self._asked() < IDLE
            if not followed and time.monotonic() - gathered < IDLE:
                continue
            try:
                self._gathering.gather()
            except Exception:  # noqa: BLE001 - it is logged, with its traceback
                # A bug of ours, or a session that closes: the next one may do better.
                self._complaints.failure("gathering the map")
            gathered = time.monotonic()
