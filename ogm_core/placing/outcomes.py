"""Outcomes of scans: what becomes of each is counted, and told where something is wrong with it."""

from ogm_core.placing.hints import Hint
from ogm_core.placing.reasons import Reason
from ogm_core.placing.receipts import DropReason, OfOthers, Receipts
from ogm_core.placing.robots import Complain, Robots


class Outcomes:
    """Counts what becomes of scans, and complains of those that do not come into the map.

    `receipts` are for whoever asks, and `robots` count what is stored with the scans' seqs.
    """

    def __init__(self, receipts: Receipts, robots: Robots, complain: Complain) -> None:
        self.receipts = receipts
        self.complain = complain
        self._robots = robots

    def integrated(self, name: str, sensor: str, beams_on_robots: int) -> None:
        """A scan is in the map, but for so many beams that ended at other robots."""
        self.receipts.scan_integrated(name, sensor, beams_on_robots)
        self._robots.count(name, sensor, "integrated")
        if beams_on_robots:
            self._robots.count(name, sensor, "beams_on_robots", beams_on_robots)

    def of_others(self, name: str, sensor: str, kind: OfOthers) -> None:
        """A scan is another share's to count."""
        self.receipts.scan_of_others(name, sensor, kind)
        self._robots.count(name, sensor, kind)

    def failed(self, name: str, sensor: str) -> None:
        """A bug keeps a scan out of the map."""
        self._dropped(name, sensor, "failed")

    def refuse(self, name: str, sensor: str, whom: str, why: Reason) -> None:
        """A scan is of one robot or sensor too many: `whom` that is told of."""
        self.receipts.scan_dropped(name, sensor, "refused")
        self.complain(whom, *why)

    def drop(self, name: str, sensor: str, reason: DropReason, why: Reason) -> None:
        """A scan of a robot's sensor is dropped."""
        self._dropped(name, sensor, reason)
        self.complain(f"{name}/{sensor}", why.kind, f"a scan is dropped ({reason}): {why.text}")

    def drop_of_others(self, name: str, sensor: str, why: Reason) -> None:
        """A scan that is another share's to count does not come into this one's cells, for want of memory."""
        self.of_others(name, sensor, "border_dropped")
        self.complain(f"{name}/{sensor}", why.kind, f"a scan of another share is dropped here: {why.text}")

    def hint(self, name: str, sensor: str, hint: Hint) -> None:
        """The data of a robot's sensor seem wrong."""
        self.receipts.hint(name, sensor, hint.slug)
        self.complain(f"{name}/{sensor}", f"hint {hint.slug}", hint.text)

    def _dropped(self, name: str, sensor: str, reason: DropReason) -> None:
        self.receipts.scan_dropped(name, sensor, reason)
        self._robots.count(name, sensor, reason)
