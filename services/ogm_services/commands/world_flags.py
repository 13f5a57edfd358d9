"""Flags of the world that robots are simulated in."""

import math
from typing import Annotated

import typer

from ogm_core.errors import BadInput

World = Annotated[
    str,
    typer.Option("--world", metavar="WORLD", help="lab, office, or the YAML file of a world or a ROS map."),
]
Start = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y",
        help="Where in a ROS map the first robot begins, in metres (default: 0,0 if free, else its largest "
        "free space inside).",
    ),
]


def point(flag: str, text: str | None) -> tuple[float, float] | None:
    """The point X,Y that a flag gives, m.

    Raises:
        BadInput: it gives something else.
    """
    if text is None:
        return None
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not (math.isfinite(x) and math.isfinite(y)):
        raise BadInput(f"{flag}: two numbers X,Y in metres are needed, got {text!r}")
    return x, y
