"""Parameters of questions for the map: which part of it, of which moment, and how it is drawn."""

from dataclasses import replace
from typing import Final

from ogm_core.cells.value_bytes import COLOURS
from ogm_core.errors import BadParameter
from ogm_core.files.map_files import PALETTES, VALUES
from ogm_core.lattice import Lattice, Region
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.polygon import MAX_POINTS, Polygon
from ogm_core.wire.keys import MAX_NAME, NAME
from ogm_services.mapper.serving.query_parameters import (
    SAVED_AS,
    ChoiceParameter,
    NumberParameter,
    NumbersParameter,
    TextParameter,
)
from ogm_services.replies.answer import Parameters

REGION: Final = NumbersParameter(
    "region",
    "xmin,ymin,xmax,ymax in metres: rounded outward to cells, and clipped to the map",
    "xmin,ymin,xmax,ymax",
    *(2, 2),
    example="-1,-1,1,1",
)
ERASED_REGION: Final = replace(REGION, said="xmin,ymin,xmax,ymax in metres: the cells whose centre it holds")
POLYGON: Final = NumbersParameter(
    "polygon",
    f"x1,y1,x2,y2,... in metres, 3 to {MAX_POINTS} corners in order, in place of a region: even-odd where it "
    "crosses itself",
    f"x1,y1,x2,y2,... of 3 to {MAX_POINTS} points",
    *(3, MAX_POINTS),
    example="0.5,-0.5,1,-0.5,1,0.5",
)
PALETTE: Final = ChoiceParameter(
    "palette",
    "ros (trinary: 0 occupied, 254 free, 205 neither) or probability (brighter is occupied), both grey; "
    "cividis (the same in colours), dark (trinary), costmap (as RViz draws it)",
    tuple(COLOURS),
)
GREY_PALETTE: Final = ChoiceParameter(
    "palette",
    "ros (trinary: 0 occupied, 254 free, 205 neither) or probability (brighter is occupied)",
    tuple(PALETTES),
)
TRANSPARENT: Final = ChoiceParameter("transparent", "1: what is unknown is not drawn", ("0", "1"))
MAX_SIZE: Final = NumberParameter(
    "max_size",
    "longest side in pixels: the picture is shrunk by a whole factor",
    *(1, 999_999_999),
    whole=True,
    optional=True,
    example=800,
)
MAP_VALUES: Final = ChoiceParameter(
    "values", "percent (0 to 100, -1 unknown) or trinary (0, 100, -1)", tuple(VALUES)
)
FINE, COARSE = "fine", "coarse"
FINE_FIRST: Final = ChoiceParameter(
    "resolution",
    "of a map of cell model rate: fine (cells of half the size that beams are counted in) or coarse (these)",
    (FINE, COARSE),
)
COARSE_FIRST: Final = replace(FINE_FIRST, words=(COARSE, FINE))
"""For robots and displays of ROS, who were told the map's resolution."""
AT: Final = TextParameter(
    SAVED_AS,
    "the map as it was saved under this name (POST /save), in place of the live one",
    "before_lunch",
    NAME.pattern,
    f"a name of 1 to {MAX_NAME} of A-Z a-z 0-9 _ - .",
)
SNAPSHOT_NAME: Final = replace(AT, name="name", said="it says which snapshot", needed=True)
COMPLETE: Final = ChoiceParameter(
    "complete", "1: while a share of the map is missing, refuse to answer, in place of the rest", ("0", "1")
)
COMPLETE_FIRST: Final = replace(COMPLETE, words=("1", "0"))
"""For what a planner loads, to which unknown cells may be free ones."""
ROBOT: Final = TextParameter("robot", "it says which robot", "robot1", NAME.pattern, AT.form, needed=True)
CELL_X: Final = NumberParameter("x", "metres, map frame", example=1.5)
CELL_Y: Final = NumberParameter("y", "metres, map frame", example=0.5)


def region_of(given: Parameters) -> Region | None:
    """The region that is asked for, None if none is.

    Raises:
        BadParameter: it is ill-formed.
    """
    numbers = REGION.read(given)
    return None if numbers is None else Region(*numbers)


def area_of(given: Parameters, lattice: Lattice) -> Polygon:
    """The area that is named, by a region or by the corners of a polygon.

    Raises:
        BadParameter: it is ill-formed, or there is none, or more than one.
    """
    if len(given.keys() & {ERASED_REGION.name, POLYGON.name}) != 1:
        raise BadParameter("region or polygon: one of them is needed, to say where")
    region, numbers = region_of(given), POLYGON.read(given)
    if region is not None:
        return Polygon.of_region(region, lattice)
    assert numbers is not None
    return Polygon(list(zip(numbers[::2], numbers[1::2], strict=True)), lattice)


def served(snapshot: MapSnapshot, parameter: ChoiceParameter, given: Parameters) -> MapSnapshot:
    """The map in the cells that are asked for, of those that its model has.

    Raises:
        BadParameter: `resolution` is neither fine nor coarse.
    """
    return snapshot.finest() if parameter.read(given) == FINE else snapshot


def shrunk(snapshot: MapSnapshot, given: Parameters) -> MapSnapshot:
    """The map as small as is asked for.

    Raises:
        BadParameter: `max_size` is no number of pixels.
    """
    return snapshot.shrink(int(MAX_SIZE.read(given))) if MAX_SIZE.name in given else snapshot


def transparent(given: Parameters) -> bool:
    """Whether what is unknown is not to be drawn.

    Raises:
        BadParameter: `transparent` is neither 0 nor 1.
    """
    return TRANSPARENT.read(given) == "1"
