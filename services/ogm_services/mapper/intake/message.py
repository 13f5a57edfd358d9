"""Message on its way from Zenoh's callback to the worker, or a command in its place."""

from collections.abc import Callable
from dataclasses import dataclass

from ogm_core.wire.keys import Source


@dataclass(slots=True, eq=False)
class Message:
    """A message's payload and where it came from, or a command for the worker."""

    source: Source | None
    payload: bytes
    arrival: float
    """When it came, s of the monotonic clock."""
    command: Callable[[], None] | None = None
    cells: float | None = None
    """How many cells' time a scan will take, more than 0; None as long as nobody has looked."""
    robot: str | None = None
    """Whose command it is: it takes the room of one of that robot's poses, and like them is never dropped."""
    resumed: bool = False
    """Whether it was missed, or held back, before: it waits for room beside what just comes."""
    dropped: bool = False

    @property
    def sender(self) -> str | None:
        """Whose message or command it is; None of the mapper's own commands."""
        return self.robot if self.source is None else self.source.robot
