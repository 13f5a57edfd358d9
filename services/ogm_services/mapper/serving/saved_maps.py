"""Saved maps: what a mapper answers of the snapshots that it has on disk under names."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import SnapshotList, encode_status
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.map_formats import MapFormat, bytes_to_make
from ogm_services.mapper.serving.map_parameters import region_of, shrunk
from ogm_services.mapper.storage.snapshots import SavedMap, Snapshots
from ogm_services.replies.answer import Answer, Parameters

COPIES = 2
"""A map is read, and then copied for who encodes it."""


class SavedMaps:
    """Answers about snapshots, read anew for each: nothing of them stays in memory. Any thread.

    Whoever asks reads by himself, so that neither the worker nor the store's thread waits for him.
    """

    def __init__(
        self, snapshots: Snapshots, settings: GridSettings, map_name: str, memory: AnswerMemory
    ) -> None:
        """`settings` are the live map's, and so is the `memory`."""
        self._snapshots = snapshots
        self._settings = settings
        self._map_name = map_name
        self._memory = memory

    def list(self) -> Answer:
        """Every snapshot, by name."""
        return Answer(encode_status(SnapshotList(self._snapshots.list())), "application/json")

    def map(self, name: str, wanted: MapFormat, given: Parameters) -> Answer:
        """The map that is saved under a name in a format, with the identity that it had.

        Raises:
            UnknownSnapshot, BadParameter, BadStore, BadSetting: there is none, or it cannot be read.
            MapEmpty: a picture of a map without a known cell.
            Busy: it is large, and there is no memory or no thread left for it.
        """
        region, model = region_of(given), self._settings.cell_model

        def to_make(rect: CellRect) -> int:
            shown = rect if region is None else rect.intersection(self._settings.lattice.cover(region))
            # Halves have planes of their own, which take at most twice as much as those of their cells.
            return bytes_to_make(wanted, model, model.finest * wanted.cells_looked_at(shown.cells, given))

        with self.opened(name, to_make) as saved:
            whole = wanted.served(saved, given)
            pixels = shrunk(whole if region is None else whole.crop(region), given)
            body = wanted.encode(pixels, self._map_name, given)
        return Answer(body, wanted.media_type, pixels.meta())

    @contextmanager
    def opened(self, name: str, to_make: Callable[[CellRect], int] = lambda _: 0) -> Iterator[MapSnapshot]:
        """The map that is saved under a name, for as long as something is made of it inside.

        `to_make`: bytes that this takes, besides the map, of one whose cells these are. Raises as `map`.
        """
        with self._snapshots.opened(name) as saved:
            rect = self._rect_of(saved)
            size = COPIES * saved.nbytes + to_make(rect)
            with self._memory.large.making(rect.cells), self._memory.in_flight.making(size):
                yield saved.grid(self._settings).snapshot()

    def _rect_of(self, saved: SavedMap) -> CellRect:
        return self._settings.clipped_bounds or saved.state.map.known or CellRect(0, 0, 0, 0)
