"""Time series of how a map settles: entropy, known area, predicted hits, in a bounded number of samples."""

from typing import Any, NamedTuple

from ogm_core.quality.bounded import VISITS
from ogm_core.quality.figures import map_figures_within
from ogm_core.snapshot import MapSnapshot

CAPACITY = 256
"""When so many samples are full, every second one goes, and they are taken half as often from then on."""
PERIOD = 1.0
"""The first samples of a map are so far apart, s."""
REST = 50.0
"""After a look that took c seconds the next one comes REST * c later: 2 % of a core at most."""


class Sample(NamedTuple):
    """Figures of a map at one revision; `stamp` is that of its newest integrated scan, ns.

    `hit`: how well it has predicted scans since the sample before (see `predicted_hits`); None if none.
    """

    stamp: int
    revision: int
    mean_entropy_bits: float
    entropy_bits: float
    known_m2: float
    hit: float | None


class History:
    """The samples of one life of a map, of one epoch; a new epoch begins a new series.

    One thread calls `due` and `take`; any other may call `columns`. No clock is read here: times are given,
    in s on a clock that never goes back.
    """

    def __init__(self) -> None:
        self._epoch = ""
        self._samples: tuple[Sample, ...] = ()
        self._seen = -1
        """The revision that was looked at last."""
        self._period = PERIOD
        self._next = 0.0

    def due(self, epoch: str, revision: int, now: float) -> bool:
        """Whether the map, now at `revision`, is to be looked at: it has changed, and it is time."""
        return epoch != self._epoch or (revision != self._seen and now >= self._next)

    def take(self, snapshot: MapSnapshot, sample: Sample | None, began: float, ended: float) -> None:
        """Keep what a look at the map has found; None: there is no known cell yet."""
        if snapshot.epoch != self._epoch:
            self._begin(snapshot.epoch)
        if sample is not None:
            if len(self._samples) == CAPACITY:
                self._samples = self._samples[::2]
                self._period *= 2.0
            self._samples = (*self._samples, sample)
        self._seen = snapshot.revision
        self._next = max(began + self._period, ended + REST * (ended - began))

    def columns(self, epoch: str) -> dict[str, list[Any]]:
        """The samples of that epoch, a list for each field of Sample, oldest first; all of equal length."""
        # The writer replaces the tuple and never changes it; a new series starts out empty.
        samples = self._samples if epoch == self._epoch else ()
        return {name: [sample[k] for sample in samples] for k, name in enumerate(Sample._fields)}

    def _begin(self, epoch: str) -> None:
        self._samples = ()
        self._epoch = epoch
        self._period = PERIOD


def sample_of(snapshot: MapSnapshot, hit: float | None = None) -> Sample | None:
    """The figures of a map, and how well it has predicted scans; None before a scan has made a cell known."""
    if snapshot.stamp is None:
        return None
    figures, _, _ = map_figures_within(snapshot.finest(), VISITS)
    if not figures["known_m2"]:
        return None
    return Sample(
        snapshot.stamp,
        snapshot.revision,
        figures["mean_entropy_bits"],
        figures["entropy_bits"],
        figures["known_m2"],
        hit,
    )
