"""Sources of one robot: those that were heard of, and what is missing of them."""

import threading
from collections.abc import Set

from ogm_core.placing.rules import MAX_SENSORS
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake.handing_on import Decided
from ogm_services.mapper.intake.held_source import HeldSource
from ogm_services.mapper.intake.numbering import Numbering


class RobotSources:
    """A robot's poses and its sensors, as far as messages of them came, or their caches. Any thread."""

    def __init__(self, name: str, decided: Decided, lock: threading.RLock) -> None:
        """`lock` is the robot's: under it sources are added, and messages that come are handed on."""
        self._name = name
        self._decided = decided
        self._lock = lock
        self.by_sensor: dict[str | None, HeldSource] = {}
        """By sensor, None for the robot's poses."""

    @property
    def heard(self) -> float:
        """When it was heard last, s; 0 if it never was."""
        return max((known.heard for known in list(self.by_sensor.values())), default=0.0)

    def admitted(self, sensor: str | None, now: float) -> HeldSource | None:
        """What is known of a source; None if it is one sensor too many."""
        known = self.by_sensor.get(sensor)
        if known is None:
            with self._lock:
                if sensor is None or sum(name is not None for name in self.by_sensor) < MAX_SENSORS:
                    numbering = Numbering(lambda run: self._decided.last(self._name, sensor, run))
                    known = self.by_sensor.setdefault(sensor, HeldSource(numbering, now))
        return known

    def unread(self, sensor: str | None) -> None:
        """Note a message whose number nobody has read."""
        known = self.by_sensor.get(sensor)
        if known is not None:
            known.numbering.unread += 1

    def too_silent(self, now: float) -> bool:
        """Whether a source that has a cache is silent for so long that it is to be asked."""
        silent = False
        for known in list(self.by_sensor.values()):
            silent |= known.too_silent(now)
        return silent

    def wanted(self, source: Source, run: str) -> int | None:
        """The first seq of a run that was not handed on; None if nothing is known of the run."""
        known = self.by_sensor.get(source.sensor)
        last = self._decided.last(*source, run) if known is None else known.numbering.last(run)
        return None if last is None else last + 1

    def lacks_any(self, sources: Set[Source], runs: Set[str]) -> bool:
        """Whether a source has not answered that must have something: its cache is there, or a run's was.

        `sources` have answered, with messages of `runs`. Without poses, say, scans would be taken too early.
        """
        with self._lock:
            for sensor, known in {None: None, **self.by_sensor}.items():
                source = Source(self._name, sensor)
                if source in sources:
                    continue
                if known is None:
                    lacks = any(run and self._decided.last(*source, run) is not None for run in runs)
                else:
                    has_cache = bool(known.caches) and known.numbering.begun
                    lacks = has_cache or any(map(known.numbering.has, runs))
                if lacks:
                    return True
        return False
