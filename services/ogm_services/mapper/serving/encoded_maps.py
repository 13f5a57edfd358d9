"""Encoded maps: the live map in the formats of MAP_FORMATS, encoded once for all who ask for the same."""

from collections.abc import Callable

from ogm_core.cells.value_bytes import COLOURS, value_byte
from ogm_core.files.map_files import PALETTES
from ogm_core.lattice import Region
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.snapshot import MapSnapshot
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.answer_cache import AnswerCache
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.map_formats import MAP_FORMATS, MapFormat, bytes_to_make, map_format
from ogm_services.mapper.serving.map_parameters import PALETTE, region_of, shrunk, transparent
from ogm_services.replies.answer import Answer, Parameters


class EncodedMaps:
    """The live map as bytes. Any thread.

    What was encoded is kept until the map changes; pictures of the whole map are brought up to date where it
    has changed.
    """

    def __init__(self, map_name: str, live_map: ServedMap, cache: AnswerCache, memory: AnswerMemory) -> None:
        """The `cache` keeps them, beside what others put there."""
        self._map_name = map_name
        self._map = live_map
        self._cache = cache
        self._memory = memory
        self._pictures = {name: MapPicture(encoder) for name, encoder in PALETTES.items()}
        self._coloured = MapPicture(value_byte)
        memory.count(*self._pictures.values(), self._coloured)

    def answer(self, form: str, given: Parameters) -> Answer:
        """The map as it is now in a format.

        Raises:
            UnknownName: there is no such format.
            BadParameter: a parameter is unknown or ill-formed, or its region misses the map.
            MapEmpty: a picture of a map without a known cell.
            Busy: it is large, and there is no memory or no thread left for it.
        """
        wanted, key = map_format(form, given), (form, tuple(sorted(given.items())))
        asked, region = self._map.now, region_of(given)

        def make() -> Answer:
            snapshot = self._map.snapshot()
            answer = self._made(wanted, snapshot, given, region)
            self._cache.keep(key, Identity.of(snapshot), answer)
            self._memory.make_room()
            return answer

        looked_at = self._cells_looked_at
        return self._cache.answer(
            key, asked, lambda: self._memory.large.making(looked_at(form, given, region)), make
        )

    def answer_of(self, take: Callable[[], MapSnapshot], form: str, given: Parameters) -> Answer:
        """Another map in a format, such as the live one without a part; it is taken when there is a place.

        Raises as `answer`; nothing of it is kept.
        """
        wanted, region = map_format(form, given), region_of(given)
        with self._memory.large.making(self._cells_looked_at(form, given, region)):
            return self._made(wanted, take(), given, region)

    def _cells_looked_at(self, form: str, given: Parameters, region: Region | None) -> int:
        """How many cells an answer looks at; the picture that is kept up to date looks at few."""
        if form == "png" and given.keys() <= {"palette", "transparent"}:
            return 0
        return MAP_FORMATS[form].cells_looked_at(self._map.cells_in(region, finest=True), given)

    def _made(
        self, wanted: MapFormat, whole: MapSnapshot, given: Parameters, region: Region | None
    ) -> Answer:
        """A map in a format."""
        snapshot = wanted.served(whole, given)
        cropped = snapshot if region is None else snapshot.crop(region)
        picture = self._picture_of(wanted, cropped, given) if cropped is snapshot else None
        if picture is None:
            cells = wanted.cells_looked_at(cropped.width * cropped.height, given)
            size = bytes_to_make(wanted, cropped.model, cells)
        else:  # only what has changed is encoded, and what was is put together
            size = 2 * picture.nbytes + cropped.width * cropped.height // 16
        with self._memory.in_flight.making(size):
            shown = shrunk(cropped, given)
            if picture is None:
                body = wanted.encode(shown, self._map_name, given)
            elif picture is self._coloured:
                colours = COLOURS[PALETTE.read(given)]
                body = picture.png(snapshot, colours, transparent=transparent(given))
            else:
                body = picture.png(snapshot)
        return Answer(body, wanted.media_type, shown.meta())

    def _picture_of(self, wanted: MapFormat, whole: MapSnapshot, given: Parameters) -> MapPicture | None:
        """The picture of the whole map that is kept up to date, if that is what is wanted."""
        if (
            whole.missing
            or wanted is not MAP_FORMATS["png"]
            or whole.empty
            or given.keys() & {"max_size", "resolution"}
        ):
            return None
        palette = PALETTE.read(given)
        return self._coloured if transparent(given) else self._pictures.get(palette, self._coloured)
