"""Tags of tiles: the same from every gateway that has heard the same of the shares which a tile shows."""

import numpy as np

from ogm_core.cells.model import CellModel
from ogm_core.lattice import CellRect
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.copies import TileCopies
from ogm_core.tiles.pyramid import Square
from ogm_core.tiles.store import TILE
from ogm_core.tiles.view import TileView
from ogm_services.mapper.shares.layout import ShareLayout
from ogm_services.mapper.shares.share_parts import PartState, hash_of

MAX_SOURCES = 4096
"""When so many are remembered, those of which nothing is left are forgotten."""


class TileTags:
    """Remembers with which state of which share each part came. Who gathers notes them, any thread asks."""

    def __init__(self, layout: ShareLayout, model: CellModel) -> None:
        self._layout = layout
        self._model = model
        self._sources: dict[int, str] = {}
        """By the gateway's own revision: share, run and revision of the part that came with it."""

    def note(self, revision: int, share: int, part: PartState, before: TileCopies) -> None:
        """Note that a share's part comes with a revision of the gathered map; `before`: its tiles so far."""
        if len(self._sources) >= MAX_SOURCES:
            used = set(np.unique(before.of).tolist())
            self._sources = {number: source for number, source in self._sources.items() if number in used}
        self._sources[revision] = f"{share} {part.run} {part.revision}"

    def tag(self, snapshot: MapSnapshot, square: Square) -> str:
        """That of a tile of a snapshot of the followed map: its epoch, and a hash of what it shows.

        Two tiles with the same tag have the same pixels.
        """
        view = snapshot.stored
        assert isinstance(view, TileView)
        copies = view.tiles
        x0, y0, x1, y1 = _window(square.rect, self._model, copies.rect)
        of, owners = copies.of[x0:x1, y0:y1], self._layout.table(copies.rect)[x0:x1, y0:y1]
        newest = [int(of[owners == share].max()) for share in np.unique(owners[of > 0]).tolist()]
        own = f"{snapshot.run} "  # of a copy that is so old that its sources are forgotten
        return f"{snapshot.epoch}-{hash_of(self._sources.get(each, f'{own}{each}') for each in newest)}"


def _window(rect: CellRect, model: CellModel, frame: CellRect) -> tuple[int, int, int, int]:
    """Which tiles of a frame the pixels of a rectangle depend on, which counts in the finest cells."""
    wide = rect.widened(model.margin * model.finest)
    side = TILE * model.finest
    left, bottom = frame.ix // TILE, frame.iy // TILE
    x0, y0 = wide.ix // side - left, wide.iy // side - bottom
    x1, y1 = -(-(wide.ix + wide.width) // side) - left, -(-(wide.iy + wide.height) // side) - bottom
    return max(x0, 0), max(y0, 0), max(x1, 0), max(y1, 0)
