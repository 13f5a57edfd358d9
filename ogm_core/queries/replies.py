"""Replies to queries, as they stand in JSON, name by name and in this order."""

from dataclasses import dataclass
from typing import Literal

RayEnd = Literal["hit", "unknown", "none"]
FootprintState = Literal["occupied", "unknown", "free"]


@dataclass(frozen=True, slots=True)
class RaycastReply:
    """Of each ray its range, m, and how it `ends`: a "hit", at an "unknown" cell, or with "none" of them.

    `epoch`, `run` and `revision` say which map it is of.
    """

    epoch: str
    run: str
    revision: int
    ranges: list[float]
    ends: list[RayEnd]


@dataclass(frozen=True, slots=True)
class CheckReply:
    """Of each point or footprint, in the order in which they were given: "occupied", "unknown" or "free".

    `epoch`, `run` and `revision` say which map it is of.
    """

    epoch: str
    run: str
    revision: int
    states: list[FootprintState]
