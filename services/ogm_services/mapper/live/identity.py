"""Identity of a map: which it is, the process that writes it, and how far it has come."""

from typing import NamedTuple

from ogm_core.grid import OccupancyGrid
from ogm_core.snapshot import MapSnapshot


class Identity(NamedTuple):
    """Which map it is, the process that writes it, and how far it has come."""

    epoch: str
    run: str
    revision: int
    stamp: int | None

    @classmethod
    def of(cls, told: OccupancyGrid | MapSnapshot) -> "Identity":
        """That of a map, or of a copy."""
        return cls(told.epoch, told.run, told.revision, told.stamp)

    @property
    def life(self) -> tuple[str, str]:
        """Within one, a higher revision is a newer map."""
        return self.epoch, self.run
