"""`ogm erase`: cells of a running mapper's map made unknown.

It imports what it needs when it runs, so that `ogm --help` answers at once.
"""

import json
from typing import Annotated

import typer

from ogm_core.errors import BadInput
from ogm_services.commands.write_flags import WriteFlags
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import ClientFlags
from ogm_services.settings.values import parse_number, parse_region

Region = Annotated[
    str | None, typer.Option(metavar="XMIN,YMIN,XMAX,YMAX", help="A rectangle, m: --region=-1,-1,1,1")
]
Polygon = Annotated[
    str | None,
    typer.Option(metavar="X1,Y1,X2,Y2,...", help="Its 3 to 64 corners in order, m: --polygon=0,0,2,0,1,1.5"),
]


@with_flag_groups
def erase(network: ClientFlags, asked: WriteFlags, region: Region = None, polygon: Polygon = None) -> None:
    """Make the cells of an area unknown, as where a person stood; later scans fill them.

    They are those whose centre lies in the region, or in the polygon: ogm erase --region=0.5,-0.5,1,0.5
    """
    if (region is None) == (polygon is None):
        raise BadInput("--region or --polygon: one of them is needed, to say where")
    try:
        area = None if region is None else parse_region(region)
        corners = None if polygon is None else _corners(polygon)
    except ValueError as error:
        flag = "--region" if polygon is None else "--polygon"
        raise BadInput(f"{flag}: {error}") from None
    with asked.client(network) as client:
        cells = client.erase(area, polygon=corners)
    if asked.as_json:
        typer.echo(json.dumps({"cells": cells}))
    else:
        typer.echo(f"{cells} cell{'' if cells == 1 else 's'} erased")


def _corners(text: str) -> list[tuple[float, float]]:
    """The corners of X1,Y1,X2,Y2,...

    Raises:
        ValueError: it is something else.
    """
    numbers = [parse_number(part) for part in text.split(",")]
    if len(numbers) % 2:
        raise ValueError(f"X1,Y1,X2,Y2,... is needed, got {len(numbers)} numbers")
    return list(zip(numbers[::2], numbers[1::2], strict=True))
