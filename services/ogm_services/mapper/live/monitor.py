"""Monitor: watches, whether anybody asks or not, how the map grows and settles, and what is true."""

import logging
import threading
import time
from collections.abc import Callable, Sequence

from ogm_services.mapper.live.history import History, sample_of
from ogm_services.mapper.live.predicted_hits import PredictedHits
from ogm_services.mapper.live.served_map import WatchedMap
from ogm_services.mapper.live.true_world import Text, TrueWorld

LOOK_PERIOD = 1.0
"""How often it looks, s."""
REST = 10.0
"""After worlds that took c seconds to read simulators are asked again REST * c later: a tenth of a core."""
TRUTH_END = 1.0
"""How long stopping waits for worlds that are being read, s: they are nobody's concern any more."""

log = logging.getLogger(__name__)


class Monitor:
    """Looks at a live map once a second. Started once, stopped once.

    Who owns what: one thread writes the series, and one the truth, which strangers may tell and which may
    take seconds to read; readers take what is there, so that no answer ever waits for the network. The map
    is read through snapshots, as everyone but the worker does.
    """

    def __init__(self, live_map: WatchedMap) -> None:
        self.series = History()
        self._hits = PredictedHits(live_map)
        self.truth = TrueWorld()
        self._map = live_map
        self._stopping = threading.Event()
        self._rest = 0.0
        self._threads: list[threading.Thread] = []

    def start(self, ask_truth: Callable[[], Sequence[Text]]) -> None:
        """Begin to look; `ask_truth` gets what simulators say their world is, and may take a while."""
        # A daemon: the process may end while it reads a world.
        self._threads = [
            threading.Thread(target=self._look_at_map, name="ogm-monitor"),
            threading.Thread(target=self._look_for_truth, args=(ask_truth,), name="ogm-truth", daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """Finish the look in hand, and end; worlds that are being read are given up."""
        if self._threads:
            self._stopping.set()
            looking, hearing = self._threads
            hearing.join(TRUTH_END)
            looking.join()
            self.truth.settle()

    def _look_at_map(self) -> None:
        while not self._stopping.is_set():
            self._survive(self._look)
            self._stopping.wait(LOOK_PERIOD)

    def _look_for_truth(self, ask_truth: Callable[[], Sequence[Text]]) -> None:
        while not self._stopping.is_set():
            self._survive(lambda: self._hear(ask_truth))
            self._stopping.wait(max(LOOK_PERIOD, self._rest))

    def _survive(self, look: Callable[[], None]) -> None:
        try:
            look()
        except Exception:
            # A bug of ours: its traceback is kept, and the next look may do better.
            log.exception("a look at the map failed")

    def _hear(self, ask_truth: Callable[[], Sequence[Text]]) -> None:
        epoch, told = self._map.now.epoch, ask_truth()
        began = time.monotonic()
        self.truth.heard(epoch, told)
        self._rest = REST * (time.monotonic() - began)

    def _look(self) -> None:
        epoch, _, revision, _ = self._map.now
        began = time.monotonic()
        if self.series.due(epoch, revision, began):
            hit = self._hits.share()  # by the copy of before, which this snapshot takes the place of
            snapshot = self._map.snapshot()
            self.series.take(snapshot, sample_of(snapshot, hit), began, time.monotonic())
        self._map.count_known()
