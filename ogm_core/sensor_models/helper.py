"""Helper: a thread that does what another tells it, on another processor than that one's."""

import threading
from collections.abc import Callable
from queue import SimpleQueue

from ogm_core.sensor_models.processors import KeptOff, keep_off, let_back

Job = Callable[[], object]


class Helper:
    """A thread with an inbox; it runs until it is told to `end`, or an error ends it.

    Who owns what: one thread tells. It sets `_kept_off` before it posts a job, and the helper takes that back
    before it begins the job: while it is set nobody is kept off again.
    """

    def __init__(self, name: str) -> None:
        self._inbox: SimpleQueue[Job | None] = SimpleQueue()
        self._kept_off: KeptOff | None = None
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread runs."""
        return self._thread.is_alive()

    def tell(self, job: Job) -> None:
        """Have a job done, after those that were told before."""
        if self._kept_off is None and self._thread.native_id is not None:
            self._kept_off = keep_off(self._thread.native_id)
        self._inbox.put(job)

    def end(self) -> None:
        """Let the thread end after all that it was told; see `join`."""
        self._inbox.put(None)

    def join(self) -> None:
        """Wait until the thread has ended."""
        self._thread.join()

    def _work(self) -> None:
        while (job := self._inbox.get()) is not None:
            kept_off = self._kept_off
            if kept_off is not None:
                let_back(kept_off)
                self._kept_off = None
            job()
            del job  # it has the store's memory
