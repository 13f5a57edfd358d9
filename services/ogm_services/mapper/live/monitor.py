"""Monitor: watches, whether anybody asks or not, how the map grows and settles, and what is true."""

import logging
import threading
import time
from collections.abc import Callable

from ogm_services.mapper.live.history import History, sample_of
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.true_world import TrueWorld

LOOK_PERIOD = 1.0
"""How often it looks, s."""

log = logging.getLogger(__name__)


class Monitor:
    """Looks at a live map once a second. Started once, stopped once.

    Who owns what: only its thread writes the series and the truth; readers take what is there, so that no
    answer ever waits for the network. It reads the map through snapshots, as everyone but the worker does,
    and holds no lock while it asks for the truth.
    """

    def __init__(self, live_map: LiveMap) -> None:
        self.series = History()
        self.truth = TrueWorld()
        self._map = live_map
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, ask_truth: Callable[[], list[bytes]]) -> None:
        """Begin to look; `ask_truth` gets what simulators say their world is, and may take a while."""
        self._thread = threading.Thread(target=self._run, args=(ask_truth,), name="ogm-monitor")
        self._thread.start()

    def stop(self) -> None:
        """Finish the look in hand, and end."""
        if self._thread is not None:
            self._stopping.set()
            self._thread.join()
            self.truth.settle()

    def _run(self, ask_truth: Callable[[], list[bytes]]) -> None:
        while not self._stopping.is_set():
            try:
                self._look(ask_truth)
            except Exception:
                # A bug of ours: its traceback is kept, and the next look may do better.
                log.exception("a look at the map failed")
            self._stopping.wait(LOOK_PERIOD)

    def _look(self, ask_truth: Callable[[], list[bytes]]) -> None:
        epoch, revision, _ = self._map.now
        self.truth.heard(epoch, ask_truth())
        began = time.monotonic()
        if self.series.due(epoch, revision, began):
            snapshot = self._map.snapshot()
            self.series.take(snapshot, sample_of(snapshot), began, time.monotonic())
        self._map.count_known()
