"""Health of the service, as probes ask for it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ogm_core.errors import printable


@dataclass(frozen=True)
class Health:
    """Whether the mapper works, and whether it should get scans."""

    alive: Callable[[], bool]
    reasons: Sequence[Callable[[], str | None]] = ()
    """Each tells why it should get none now, or None."""

    def not_alive(self) -> str | None:
        """Why it should be started again; None if it works."""
        return None if self.alive() else "the worker has stopped"

    def not_ready(self) -> str | None:
        """Why it should get no scans now, all reasons on one line; None if it should."""
        found = [self.not_alive(), *(reason() for reason in self.reasons)]
        return printable("; ".join(filter(None, found))) or None
