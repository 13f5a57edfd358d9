"""Held scans: which scans of a log go into a map, and which stay out of it to judge it."""

from dataclasses import dataclass

from ogm_core.errors import BadInput

_BLOCKS = 10
"""Blocks begin every so many scans that are held out."""


@dataclass(frozen=True, slots=True)
class HeldScans:
    """Of a log only one scan in `every` counts, and of these one in `hold_out` is held out; None: none.

    Of scans that count, numbered from 0, those with number % N == N // 2, for N = `hold_out`; in `blocks` the
    last N of every 10 N.
    """

    hold_out: int | None = None
    every: int = 1
    blocks: bool = False

    def __post_init__(self) -> None:
        if self.hold_out is not None and self.hold_out < 2:
            raise BadInput(f"--hold-out: 2 or more is needed, got {self.hold_out}")
        if self.every < 1:
            raise BadInput(f"--every: 1 or more is needed, got {self.every}")

    def counts(self, index: int) -> bool:
        """Whether scan `index` of the file, from 0, counts at all."""
        return index % self.every == 0

    def holds(self, index: int) -> bool:
        """Whether scan `index` of the file, which counts, is held out."""
        n, number = self.hold_out, index // self.every
        if n is None:
            return False
        if self.blocks:
            return number % (_BLOCKS * n) >= (_BLOCKS - 1) * n
        return number % n == n // 2


ALL_MAPPED = HeldScans()
