"""Account of what became of robots' messages: counted, and what is wrong is told at a limited rate."""

from collections import Counter
from typing import Protocol

SENT = "sent"


class Tells(Protocol):
    """Who is told what is wrong, as a LimitedLog is."""

    def of_kind(self, source: str, kind: str, text: str) -> None:
        """Say `text` of a source; what is of one kind is said together."""


class Account:
    """Counts by source, a robot's sensor or a topic, and outcome: sent, or why not."""

    def __init__(self, log: Tells) -> None:
        self._log = log
        self.counts: dict[str, Counter[str]] = {}

    def sent(self, source: str) -> None:
        """A scan went on to the mapper."""
        self._of(source)[SENT] += 1

    def dropped(self, source: str, reason: str, text: str, kind: str | None = None) -> None:
        """A message, or a part of it, was not used; `kind`: complaints of one kind are told together."""
        self._of(source)[reason] += 1
        self._log.of_kind(source, kind or reason, f"{reason}: {text}")

    def warned(self, source: str, reason: str, text: str) -> None:
        """Something is wrong with what goes on nevertheless."""
        self._log.of_kind(source, reason, f"{reason}: {text}")

    def note(self, source: str, text: str) -> None:
        """Tell what should be known of a source of which nothing was dropped."""
        self._log.of_kind(source, text, text)

    def lines(self) -> list[str]:
        """A line for each source, sorted."""
        return [
            f"{source}: " + ", ".join(f"{count} {outcome}" for outcome, count in sorted(found.items()))
            for source, found in sorted(self.counts.items())
        ]

    def _of(self, source: str) -> Counter[str]:
        return self.counts.setdefault(source, Counter())
