"""Models of JSON over HTTP, as its description tells them: bodies that are asked, and answers made elsewhere.

Answers to raycasts and checks, and the status, are dataclasses of the core's. That all of them are true is
tested, field by field, with what is answered.
"""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from ogm_core.queries.footprints import MAX_CORNERS, MAX_FOOTPRINTS, MAX_MARGIN

Point = tuple[float, float]
Footprint = Annotated[list[Point], Field(min_length=3, max_length=MAX_CORNERS)]
Margin = Annotated[float, Field(ge=0.0, le=MAX_MARGIN)]


class _Asked(BaseModel):
    model_config = ConfigDict(use_attribute_docstrings=True, extra="forbid")


class PointsToCheck(_Asked):
    """Points to be checked."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"points": [[1.5, 0.5]], "margin": 0.2}]})

    points: Annotated[list[Point], Field(min_length=1, max_length=MAX_FOOTPRINTS)]
    """[x, y] of each, metres, map frame."""
    margin: Margin = 0.0
    """Metres around them that are checked, too."""


class FootprintsToCheck(_Asked):
    """Footprints to be checked: polygons, even-odd where they cross themselves."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"footprints": [[[1.2, 0.3], [1.8, 0.3], [1.8, 0.7], [1.2, 0.7]]], "margin": 0.1}]
        }
    )

    footprints: Annotated[list[Footprint], Field(min_length=1, max_length=MAX_FOOTPRINTS)]
    """Corners [x, y] of each, in order, metres, map frame."""
    margin: Margin = 0.0
    """Metres around them that are checked, too."""


class LoginToken(_Asked):
    """The token that the mapper's settings have."""

    token: Annotated[str, Field(examples=["secret-of-the-mapper"])]


class _Reply(BaseModel):
    model_config = ConfigDict(use_attribute_docstrings=True)


class Problem(_Reply):
    """What went wrong (RFC 9457)."""

    type: str
    """A slug, such as "bad-parameter": what programs tell problems apart by."""
    title: str
    """What HTTP calls the status."""
    status: int
    """The HTTP status."""
    detail: str
    """What was wrong, and what to do, for people."""


class Version(_Reply):
    """Which program this is."""

    name: str
    version: str


class CellCounts(_Reply):
    """What a map of cell model rate has counted in a cell."""

    passing_m: float
    """Length of beam that passed, m."""
    hits: float
    """Hits, each shared by the cells around its point."""
    no_returns: int
    """Beams that met nothing."""


class CellState(_Reply):
    """One cell of the map."""

    x: float
    """As it was asked, m."""
    y: float
    """Likewise."""
    ix: int
    """Index of the cell, to the east of the map's anchor."""
    iy: int
    """Likewise to the north."""
    known: bool
    """Whether a scan has said anything of it."""
    log_odds: float | None
    """Of it being occupied; null if it is not known."""
    probability: float | None
    """Likewise."""
    counts: CellCounts | None = None
    """Of a map of cell model rate, within the map."""


class MapOrigin(_Reply):
    """Pose of the lower-left corner of a map."""

    x: float
    """Metres, map frame."""
    y: float
    """Likewise."""
    theta: float
    """Always 0."""


class OccupancyMap(_Reply):
    """The map, or a part of it, with all of its cells."""

    map: str
    """The map's name."""
    frame: str
    epoch: str
    run: str
    revision: int
    stamp: int | None
    """That of the newest integrated scan, ns since the Unix epoch."""
    resolution: float
    """Metres per cell."""
    width: int
    """Cells from west to east."""
    height: int
    """Cells from south to north."""
    origin: MapOrigin
    anchor: Point
    """Lower-left corner of cell (0, 0), m."""
    offset: tuple[int, int]
    """Indices of the lower-left cell."""
    data: list[int]
    """Row by row from the lower-left cell: percent (-1 unknown), or 0, 100 and -1."""


class PaletteLegend(_Reply):
    """What colours of a palette stand for, as #rrggbb."""

    occupied: str
    free: str
    undecided: str
    unknown: str


class TiledMap(_Reply):
    """Which map tiles show, and where it lies."""

    epoch: str
    run: str
    revision: int
    resolution: float
    """Metres per pixel of the tiles of the highest zoom."""
    anchor: Point
    """Upper-left corner of tile (0, 0), m."""
    extent: tuple[float, float, float, float] | None
    """xmin, ymin, xmax, ymax of what is known, m; null of an empty map."""
    palettes: list[str]
    legend: dict[str, PaletteLegend]
    """By palette."""


class TileJson(_Reply):
    """Where the tiles are (TileJSON 3.0.0, in a plane of metres and not on the earth)."""

    tilejson: str
    name: str
    """The map's name."""
    scheme: str
    tiles: list[str]
    """URL with {z}, {x} and {y}."""
    minzoom: int
    maxzoom: int
    tilesize: int
    ogm: TiledMap


class Consistency(_Reply):
    """How well the map agrees with its scans: shares, null where there was nothing to judge."""

    hits: float | None
    """Of cells where beams ended: those that are likelier occupied."""
    free: float | None
    """Of cells that beams passed: those that are likelier free."""


class JudgedShares(_Reply):
    """What the figures are of, because an answer visits so many cells at most."""

    map: float
    """Share of the map's rows."""
    scans: int
    """The newest scans, of which `consistency` is."""
    consistency: float
    """Share of all visits that the last 100 scans would take."""
    truth: float | None
    """Share of the map's rows of which `truth` is."""
    visits: int
    """What it cost: cells."""


class TruthFigures(_Reply):
    """The map against the world of the simulator that is running: shares, null where there is nothing."""

    accuracy: float | None
    precision: float | None
    recall: float | None
    iou: float | None
    log_loss: float | None
    """Nats a cell."""


class QualitySeries(_Reply):
    """How the map has settled: a list for each figure, all of the same length, oldest first."""

    stamp: list[int]
    revision: list[int]
    mean_entropy_bits: list[float]
    entropy_bits: list[float]
    known_m2: list[float]
    hit: list[float | None]
    """Share of beams, of one scan in ten, that the map had predicted before it had the scan."""


class Quality(_Reply):
    """Quality figures of the map."""

    entropy_bits: float
    """Of all known cells together."""
    mean_entropy_bits: float | None
    """Of a known cell."""
    known_m2: float
    free_m2: float
    occupied_m2: float
    consistency: Consistency
    scans: int
    cell_updates: int | None
    """None of a gateway."""
    judged: JudgedShares
    truth: TruthFigures | None
    series: QualitySeries
