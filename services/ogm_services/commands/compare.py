"""`ogm compare`: two saved maps of one lattice, cell by cell.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ogm_core.errors import BadInput
from ogm_core.whole_files import check_file, write_files
from ogm_services.results.written import out_path, written
from ogm_services.runtime.endings import INTERRUPTED
from ogm_services.runtime.loading import loading
from ogm_services.runtime.signals import running_service

if TYPE_CHECKING:
    from ogm_core.quality.comparison import Comparison

_PICTURE = "--picture"
_SHOWN = ("occupied", "free", "undecided", "unknown")


def compare(
    first: Annotated[
        Path,
        typer.Argument(metavar="MAP", help="A map.npz that was saved here, or the YAML file of a ROS map."),
    ],
    second: Annotated[Path, typer.Argument(metavar="MAP", help="Another one, of the same lattice.")],
    picture: Annotated[
        Path | None,
        typer.Option(_PICTURE, parser=out_path, metavar="FILE.png", help="Draw where they differ."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Compare two saved maps: cells by class, intersection over union, and where they differ."""
    if picture is not None:
        if picture.suffix.lower() != ".png":
            raise BadInput(f"{_PICTURE} {picture}: a name that ends in .png is needed")
        with written(picture, _PICTURE):
            check_file(picture)
    with running_service(interrupted=INTERRUPTED):
        with loading():
            from ogm_core.quality import comparison
            from ogm_core.quality.class_maps import in_cells_of_one_size, read_class_map
        tell = partial(typer.echo, err=True)
        read = read_class_map(first, tell), read_class_map(second, tell)
        maps = in_cells_of_one_size(*read)
        found = comparison.compare(*maps)
        if picture is not None:
            content = comparison.encode_difference(*maps)
            with written(picture, _PICTURE):
                write_files({picture: content})
    figures = {"resolution": maps[0].place.resolution, **_figures(found)}
    if as_json:
        typer.echo(json.dumps(figures, indent=2))
    else:
        wider = [
            f"{one.name}: in the cells of {one.place.resolution:g} m in which its beams were counted"
            for one, finest in zip(maps, read, strict=True)
            if one is not finest
        ]
        drawn = [] if picture is None else [f"{picture}: {comparison.PICTURE}"]
        typer.echo("\n".join([*wider, *_lines(figures, str(first), str(second)), *drawn]))


def _figures(found: "Comparison") -> dict[str, Any]:
    from ogm_core.quality.class_maps import CLASSES

    number = {name: CLASSES.index(name) for name in _SHOWN}
    return {
        "cells": {
            a: {b: int(found.cells[number[a], number[b]]) for b in _SHOWN if not a == b == "unknown"}
            for a in _SHOWN
        },
        "iou": {name: found.iou(number[name]) for name in ("occupied", "free")},
        "known_in_both": found.known_in_both,
        "alike": found.alike,
    }


def _lines(figures: dict[str, Any], first: str, second: str) -> list[str]:
    """The same as text: the first map's classes are rows, the second's columns."""
    rows = [[f"in {first}", *_SHOWN]]
    rows += [[a, *(str(cells.get(b, "-")) for b in _SHOWN)] for a, cells in figures["cells"].items()]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    table = ["  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows]
    iou = ", ".join(f"{name} {_share(value)}" for name, value in figures["iou"].items())
    known = figures["known_in_both"]
    return [
        f"cells by class, to the right those in {second}:",
        *table,
        f"intersection over union: {iou}",
        f"of the same class: {_share(figures['alike'])} of the {known} cells known in both",
    ]


def _share(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}"
