"""Watch: looks once a second, whether anybody asks or not, at what an operator is told of."""

import logging
import threading
import time
from collections.abc import Callable, Sequence

LOOK_PERIOD = 1.0
"""How often it looks, s."""

log = logging.getLogger(__name__)


class Watch:
    """Calls every look with the time, s of the monotonic clock, on a thread of its own.

    Started once, stopped once. Looks are short, and wait neither for the network nor for the worker.
    """

    def __init__(self, looks: Sequence[Callable[[float], None]]) -> None:
        self._looks = list(looks)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name="ogm-watch")

    def add(self, look: Callable[[float], None]) -> None:
        """One more look, before it starts."""
        self._looks.append(look)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """Finish the look in hand, and end."""
        self._stopping.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stopping.is_set():
            for look in self._looks:
                try:
                    look(time.monotonic())
                except Exception:
                    # A bug of ours: its traceback is kept, and the next look may do better.
                    log.exception("a look at the mapper failed")
            self._stopping.wait(LOOK_PERIOD)
