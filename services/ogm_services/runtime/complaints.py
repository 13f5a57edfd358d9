"""Complaints about a log's messages, told at its end: the first of every kind and source, with a count."""

from collections import Counter

MAX_LINES = 20
"""So many are told at most."""


class Complaints:
    """Collects complaints as a scan placer makes them."""

    def __init__(self) -> None:
        self._first: dict[tuple[str, str], str] = {}
        self._counts: Counter[tuple[str, str]] = Counter()

    def add(self, source: str, kind: str, text: str) -> None:
        """Take a complaint about a source, `<robot>/<sensor>` or `<robot>/pose`."""
        self._first.setdefault((source, kind), text)
        self._counts[source, kind] += 1

    def lines(self) -> list[str]:
        """What to tell, in the order in which it was met."""
        told = [
            f"{source}: {text}"
            + (f" ({count} of these)" if (count := self._counts[source, kind]) > 1 else "")
            for (source, kind), text in self._first.items()
        ]
        rest = len(told) - MAX_LINES
        return told if rest <= 0 else [*told[:MAX_LINES], f"and {rest} more of other sources and kinds"]
