"""Outcomes of scans: what becomes of each is counted, and told where something is wrong with it."""

from ogm_core.placing.hints import Hint
from ogm_core.placing.reasons import Reason
from ogm_core.placing.receipts import DropReason, Receipts
from ogm_core.placing.robots import Complain


class Outcomes:
    """Counts what becomes of scans, and complains of those that do not come into the map."""

    def __init__(self, receipts: Receipts, complain: Complain) -> None:
        self.receipts = receipts
        self.complain = complain

    def refuse(self, name: str, sensor: str, whom: str, why: Reason) -> None:
        """A scan is of one robot or sensor too many: `whom` that is told of."""
        self.receipts.scan_dropped(name, sensor, "refused")
        self.complain(whom, *why)

    def drop(self, name: str, sensor: str, reason: DropReason, why: Reason) -> None:
        """A scan of a robot's sensor is dropped."""
        self.receipts.scan_dropped(name, sensor, reason)
        self.complain(f"{name}/{sensor}", why.kind, f"a scan is dropped ({reason}): {why.text}")

    def drop_of_others(self, name: str, sensor: str, why: Reason) -> None:
        """A scan that is another share's to count does not come into this one's cells, for want of memory."""
        self.receipts.scan_of_others(name, sensor, "border_dropped")
        self.complain(f"{name}/{sensor}", why.kind, f"a scan of another share is dropped here: {why.text}")

    def hint(self, name: str, sensor: str, hint: Hint) -> None:
        """The data of a robot's sensor seem wrong."""
        self.receipts.hint(name, sensor, hint.slug)
        self.complain(f"{name}/{sensor}", f"hint {hint.slug}", hint.text)
