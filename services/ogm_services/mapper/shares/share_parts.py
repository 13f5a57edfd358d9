"""Parts of a map: what a share has told of its own cells, and which map all of them are together."""

import hashlib
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from ogm_core.lattice import CellRect

TAG_DIGITS = 32
"""Hexadecimal digits of a hash in an epoch, a run or a tag."""


class PartState(NamedTuple):
    """How far a share is, whose cells are in a gathered map."""

    epoch: str
    run: str
    revision: int
    stamp: int | None
    """Of the newest scan in it, ns since the Unix epoch, None if there is none."""
    extent: CellRect
    """The cells that it serves."""

    @property
    def tag(self) -> str:
        """What the share is asked with, to hear what has changed since."""
        return f"{self.epoch}-{self.run}-{self.revision}"


class MissingShare(NamedTuple):
    """A share that does not answer."""

    share: int
    bounds: tuple[float | None, ...]
    """xmin, ymin, xmax, ymax, m; None where it is open."""
    since: int
    """When that was noticed first, ns since the Unix epoch."""

    def described(self) -> dict[str, object]:
        """As it stands in JSON."""
        return {"share": self.share, "bounds": list(self.bounds), "since": self.since}


def life_of(parts: Sequence[PartState | None]) -> tuple[str, str]:
    """Epoch and run of the map of all shares: hashes of theirs, in order.

    One that has told nothing yet counts with an empty epoch and run.
    """
    epochs = (f"{share} {part.epoch if part else ''}" for share, part in enumerate(parts))
    runs = (f"{share} {part.run if part else ''}" for share, part in enumerate(parts))
    return hash_of(epochs), hash_of(runs)


def tag_of(parts: Sequence[PartState | None]) -> str:
    """What tells two gathered maps of one life apart: a hash of the tags of their parts."""
    return hash_of(f"{share} {part.tag if part else ''}" for share, part in enumerate(parts))


def hash_of(lines: Iterable[str]) -> str:
    """The first TAG_DIGITS digits of the SHA-256 of some lines, each of which ends with a newline."""
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()[:TAG_DIGITS]
