"""Bytes that are held for robots: each counts its own, and all of them their sum."""


class Held:
    """Bytes that somebody holds, and what all hold `within` which it is counted, too. Read by any thread."""

    __slots__ = ("_within", "nbytes")

    def __init__(self, within: "Held | None" = None) -> None:
        self.nbytes = 0
        self._within = within

    def add(self, nbytes: int) -> None:
        """Count more, or less where it is negative."""
        self.nbytes += nbytes
        if self._within is not None:
            self._within.add(nbytes)

    def clear(self) -> None:
        """Count nothing any more: all of it is let go."""
        self.add(-self.nbytes)
