"""View of a WebSocket client: what it asks to see of the map, and what of that it has seen."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ogm_core.cells.value_bytes import COLOURS
from ogm_core.errors import BadMessage, cut, printable
from ogm_core.files.map_files import DEFAULT_PALETTE
from ogm_core.tiles.pyramid import LEAST_Z, NATIVE_Z, Square
from ogm_core.wire.messages import INT_END, unpacked_fields
from ogm_services.mapper.serving.map_tiles import MAX_PLACE

MAX_VIEW_TILES: Final = 256
"""A view has so many tiles at most, those that are empty included."""
MIN_RATE, MAX_RATE, DEFAULT_RATE = 0.2, 20.0, 10.0
"""Updates a second."""

Life = tuple[str, str]
"""Epoch and run of a map."""
_Place = Annotated[int, Field(gt=-MAX_PLACE, lt=MAX_PLACE)]


class View(BaseModel):
    """The tiles from (x0, y0) to (x1, y1) of one z, in a palette; how often, and whether with scans.

    `since`: the revision of which the client has these tiles already, 0 for none.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    type: Literal["view"]
    z: Annotated[int, Field(ge=LEAST_Z, le=NATIVE_Z)]
    tiles: Annotated[list[_Place], Field(min_length=4, max_length=4)]
    palette: str = DEFAULT_PALETTE
    rate: Annotated[float, Field(ge=MIN_RATE, le=MAX_RATE, allow_inf_nan=False)] = DEFAULT_RATE
    scans: bool = False
    since: Annotated[int | None, Field(ge=0, lt=INT_END)] = None

    @property
    def first(self) -> Square:
        """Its tile with the least x and y."""
        return Square(self.z, *self.tiles[:2])

    @property
    def last(self) -> Square:
        """Its tile with the greatest x and y."""
        return Square(self.z, *self.tiles[2:])

    def shared_with(self, other: "View") -> Iterator[Square]:
        """The tiles that both show, pixel by pixel alike."""
        if self.z != other.z or self.palette != other.palette:
            return
        low = [max(pair) for pair in zip(self.tiles[:2], other.tiles[:2], strict=True)]
        high = [min(pair) for pair in zip(self.tiles[2:], other.tiles[2:], strict=True)]
        for x in range(low[0], high[0] + 1):
            for y in range(low[1], high[1] + 1):
                yield Square(self.z, x, y)


def decode_view(payload: bytes) -> View:
    """Read a client's message.

    Raises:
        BadMessage: it is no view; the text names the field.
    """
    try:
        view = View.model_validate(unpacked_fields(payload))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, first["loc"])) or "view"
        raise BadMessage(f"{cut(printable(place))}: {cut(first['msg'])}") from None
    if view.palette not in COLOURS:
        raise BadMessage(f"palette: one of {', '.join(COLOURS)} is needed, got {cut(view.palette)!r}")
    x0, y0, x1, y1 = view.tiles
    if x1 < x0 or y1 < y0:
        raise BadMessage("tiles: [x0, y0, x1, y1] with x0 <= x1 and y0 <= y1 is needed")
    if (x1 - x0 + 1) * (y1 - y0 + 1) > MAX_VIEW_TILES:
        raise BadMessage(f"tiles: {MAX_VIEW_TILES} at most, ask for less detail (z) or less of the map")
    return view


@dataclass(frozen=True)
class Seen:
    """What a client has of a view: all of a revision, and some tiles of later ones.

    So much is kept of a client and no more, however slow it is: what it has missed is what differs.
    """

    life: Life
    revision: int = -1
    """-1: nothing."""
    tiles: Mapping[Square, int] = field(default_factory=dict)
    """Revisions of those that it has been sent, or had before, besides."""

    def revision_of(self, square: Square) -> int:
        """The revision of which it has a tile, or a later one."""
        return max(self.revision, self.tiles.get(square, -1))

    def after_move(self, before: "View | None", view: View, lately: int) -> "Seen":
        """What it has of another view.

        Tiles that were not in the view `before` it asks for itself, perhaps a moment before the mapper hears
        of the new view: of those what has changed since the revision `lately` counts as not seen.
        """
        if view.since is not None:
            return replace(self, revision=view.since or -1, tiles={})
        if before is None:
            return self
        shared = {square: self.revision_of(square) for square in view.shared_with(before)}
        return replace(self, revision=min(self.revision, lately), tiles=shared)
