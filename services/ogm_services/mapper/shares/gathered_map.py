"""Gathered map: the parts of a map that is cut into shares, pasted together as they come."""

import math
import threading
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.compiled import compiled
from ogm_core.cells.model import Plane
from ogm_core.errors import BadInput, BadMessage, LimitReached
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.copies import TileCopies, Tiles
from ogm_core.tiles.pasting import NOWHERE, differing, no_tiles, pasted, without
from ogm_core.tiles.store import TILE
from ogm_core.tiles.view import TileView
from ogm_core.wire.map_update import MapUpdate
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.shares.layout import ShareLayout
from ogm_services.mapper.shares.share_parts import MissingShare, PartState, life_of, tag_of
from ogm_services.mapper.shares.tile_tags import TileTags
from ogm_services.mapper.storage.map_settings import made_otherwise


class OtherMap(BadInput):
    """A share tells of another map than the one that is to be gathered."""

    slug = "other-map"


class Gathered(NamedTuple):
    """The parts as they are held, and the cells of all of them: nobody changes it any more."""

    parts: tuple[PartState | None, ...]
    """By share; None of one that has told nothing yet."""
    copies: TileCopies
    """Their revisions are the gateway's own: it counts what it has heard."""
    life: tuple[str, str]
    """Epoch and run of the map of all shares."""
    tag: str
    """What tells its states apart within that life."""
    not_held: frozenset[int] = frozenset()
    """Shares of which only how far they are is known: for their cells there is no memory."""

    @classmethod
    def of(
        cls, parts: tuple[PartState | None, ...], copies: TileCopies, not_held: frozenset[int]
    ) -> "Gathered":
        """What such parts are together."""
        return cls(parts, copies, life_of(parts), tag_of(parts), not_held)

    @property
    def revision(self) -> int:
        """The sum of the shares'."""
        return sum(part.revision for part in self.parts if part is not None)

    @property
    def stamp(self) -> int | None:
        """Of the newest scan in any of them."""
        return max((part.stamp for part in self.parts if part and part.stamp is not None), default=None)

    def extent(self, missing: Collection[int] = ()) -> CellRect:
        """The cells that are served of all shares but the missing ones."""
        served = [
            part.extent
            for share, part in enumerate(self.parts)
            if part is not None and part.extent.cells and share not in missing
        ]
        return reduce(CellRect.union, served) if served else NOWHERE

    @property
    def named(self) -> Identity:
        """How the map is named to all the world: by its shares' epochs, runs and revisions."""
        return Identity(*self.life, self.revision, self.stamp)

    def named_by(self, run: str) -> Identity:
        """How a gateway of that `run` names it to those who follow: by what it has heard itself."""
        return Identity(self.life[0], run, self.copies.revision, self.stamp)


class GatheredMap:
    """The map of all shares, as far as they have told it.

    Who owns what: whoever gathers calls `take`, one part at a time, under `_taking`; it replaces `state`,
    which nobody changes, so that readers wait for nobody.
    """

    def __init__(
        self, settings: GridSettings, layout: ShareLayout, run: str, max_bytes: float = math.inf
    ) -> None:
        """An empty map of these settings, which may hold so many bytes; `run` is the gateway's own."""
        self.settings = settings
        self.layout = layout
        self.run = run
        self._max_bytes = max_bytes
        self._model = compiled(settings.cell_model)
        self.tags = TileTags(layout, self._model)
        """Of its tiles; any thread."""
        self._taking = threading.Lock()
        self.state = Gathered.of((None,) * layout.count, no_tiles(), frozenset())
        """The newest."""

    def check_share(self, share: int, told: Mapping[str, object]) -> None:
        """Refuse a part of a map that is cut otherwise, or made otherwise; `told` is what goes with it.

        Raises:
            OtherMap: it is.
        """
        cuts = self.layout.cuts
        ours = {"share": share, "shares": cuts.count, "cuts_x": list(cuts.x), "cuts_y": list(cuts.y)}
        for name, value in ours.items():
            if told.get(name) != value:
                raise OtherMap(
                    f"it says {name} {told.get(name)!r:.60}, and this gateway has {value}: give both the same"
                )
        otherwise = made_otherwise(told.get("settings"), self.settings)
        if otherwise is not None:
            raise OtherMap(f"it was made with {otherwise:.300}: give both the same")

    def take(self, share: int, updates: Sequence[MapUpdate]) -> None:
        """Take what a share has told, all messages of one answer.

        Raises:
            OtherMap: it is of a map of other settings, or of another share's tiles.
            LimitReached: there is no memory for it.
            BadMessage: it does not follow what is held of the share.
        """
        self._check(share, updates)
        part = _state_of(updates)
        with self._taking:
            held = None if share in self.state.not_held else self.state.parts[share]
            if part == held:
                return
            # Before anybody can see a tile of it.
            self.tags.note(self.state.copies.revision + 1, share, part, self.state.copies)
            copies = self._pasted(share, held, updates)
            if copies.nbytes > self._max_bytes:
                # Nothing old of it is kept either: its state would say that it is new.
                kept = without(self.state.copies, self.layout.table(self.state.copies.rect) == share)
                self._set(share, part, kept, self.state.not_held | {share})
                raise LimitReached(
                    f"with it the map takes {copies.nbytes} bytes, more than mapper.max_memory allows, "
                    f"{self._max_bytes:.0f}: raise that of the gateway, or ask for regions of the map"
                )
            self._set(share, part, copies, self.state.not_held - {share})

    def note(self, share: int, updates: Sequence[MapUpdate]) -> None:
        """Note how far a share is that is not held; one that has a new epoch is to be asked for its cells."""
        part = _state_of(updates)
        with self._taking:
            before, copies, not_held = self.state.parts[share], self.state.copies, self.state.not_held
            if before is not None and before.epoch != part.epoch:
                self._set(share, None, copies, not_held - {share})
            else:
                self._set(share, part, copies, not_held)

    def _set(self, share: int, part: PartState | None, copies: TileCopies, not_held: frozenset[int]) -> None:
        """Replace the state; `_taking` is held."""
        parts = (*self.state.parts[:share], part, *self.state.parts[share + 1 :])
        self.state = Gathered.of(parts, copies, not_held)

    def passing(self, max_bytes: float) -> "GatheredMap":
        """An empty map of the same shares, for parts that are not to be held."""
        return GatheredMap(self.settings, self.layout, self.run, max_bytes)

    @property
    def left(self) -> float:
        """Bytes that it may hold beside what it does."""
        return self._max_bytes - self.state.copies.nbytes

    def told(self, state: Gathered) -> MapSnapshot:
        """The map as it is named to all the world."""
        return replace(self._snapshot(state.copies, state.extent(), state.named), tag=state.tag)

    def followed(self, state: Gathered) -> MapSnapshot:
        """The map for who follows this gateway."""
        return self._snapshot(state.copies, state.extent(), state.named_by(self.run))

    def partial(self, state: Gathered, missing: Sequence[MissingShare]) -> MapSnapshot:
        """The map without the cells of shares that are missing; it is of no epoch."""
        gone = [each.share for each in missing]
        copies = without(state.copies, np.isin(self.layout.table(state.copies.rect), gone))
        nameless = self._snapshot(copies, state.extent(gone), Identity("", "", 0, state.stamp))
        return replace(nameless, missing=tuple(each.described() for each in missing))

    def _snapshot(self, copies: TileCopies, extent: CellRect, named: Identity) -> MapSnapshot:
        return MapSnapshot(
            stored=TileView(copies, extent, self._model.planes),
            model=self._model,
            lattice=self.settings.lattice,
            offset=(extent.ix, extent.iy),
            epoch=named.epoch,
            run=named.run,
            revision=named.revision,
            stamp=named.stamp,
            half_life=self.settings.half_life,
        )

    def _check(self, share: int, updates: Sequence[MapUpdate]) -> None:
        first = updates[0]
        lattice, model = self.settings.lattice, self._model
        for name, told, ours in (
            ("resolution", first.lattice.resolution, lattice.resolution),
            ("anchor", first.lattice.anchor, lattice.anchor),
            ("cells", _planes_in_words(first.planes), _planes_in_words(model.planes)),
            ("cell model", dict(first.model), model.told),
        ):
            if told != ours:
                raise OtherMap(f"its {name} is {told}, and this gateway's {ours}: give both the same")
        for update in updates:
            if len(update.tiles) and (self.layout.owners(update.tiles) != share).any():
                raise OtherMap("it tells of cells of another share: are its cuts others?")

    def _pasted(self, share: int, held: PartState | None, updates: Sequence[MapUpdate]) -> TileCopies:
        """The copies with what a share has told; `_taking` is held."""
        first, copies = updates[0], self.state.copies
        revision = copies.revision + 1
        if not first.whole:
            if held is None or (first.epoch, first.run, first.prev) != (held.epoch, held.run, held.revision):
                raise BadMessage(f"it tells what has changed since {first.prev}, which is not what is held")
            changes = [(update.tiles, update.cells) for update in updates]
        elif held is None or held.epoch != first.epoch:
            copies = without(copies, self.layout.table(copies.rect) == share) if held else copies
            changes = [(update.tiles, update.cells) for update in updates]
        else:
            changes = self._differences(share, updates)
        for places, cells in changes:
            copies = pasted(copies, places, cells, revision)
        return copies

    def _differences(self, share: int, updates: Sequence[MapUpdate]) -> list[tuple[NDArray[np.int64], Tiles]]:
        """What a whole part of the same epoch changes in what is held; tiles that are gone become unknown."""
        copies, changes = self.state.copies, []
        for update in updates:
            differ = differing(copies, update.tiles, update.cells)
            changes.append(
                (update.tiles[differ], {name: cells[differ] for name, cells in update.cells.items()})
            )
        left = (copies.numbers > 0) & (self.layout.table(copies.rect) == share)
        tiles = np.concatenate([update.tiles for update in updates])
        x, y = tiles[:, 0] - copies.rect.ix // TILE, tiles[:, 1] - copies.rect.iy // TILE
        inside = (x >= 0) & (y >= 0) & (x < left.shape[0]) & (y < left.shape[1])
        left[x[inside], y[inside]] = False
        gone = np.argwhere(left) + np.array((copies.rect.ix // TILE, copies.rect.iy // TILE))
        unknown = {
            plane.name: np.zeros((len(gone), (TILE * plane.side) ** 2), plane.dtype)
            for plane in self._model.planes
        }
        return [*changes, (gone, unknown)]


def _state_of(updates: Sequence[MapUpdate]) -> PartState:
    """How far a share is that has told these."""
    last = updates[-1]
    return PartState(last.epoch, last.run, last.revision, last.stamp, last.extent)


def _planes_in_words(planes: Sequence[Plane]) -> str:
    return ", ".join(f"{plane.name} {plane.dtype.name} x {plane.side**2}" for plane in planes)
