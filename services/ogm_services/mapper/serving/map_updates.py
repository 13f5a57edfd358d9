"""Map updates for who asks: the tiles of the live map that have changed since a revision."""

from typing import Final, cast

from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.tiles.copies import TileCopies
from ogm_core.tiles.store import tile_bytes
from ogm_core.tiles.view import TileView
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import MAX_CELL_BYTES, MEDIA_TYPE, encode_update
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.served_map import ServedMap
from ogm_services.mapper.serving.answer_cache import AnswerCache
from ogm_services.mapper.serving.large_answers import LargeAnswers
from ogm_services.mapper.serving.map_formats import UPDATES_FORMAT
from ogm_services.mapper.serving.query_parameters import TextParameter, check_names
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.in_flight import InFlight

SINCE: Final = TextParameter(
    "since",
    "the map's ETag without its quotes: only the tiles that were written since; of another life of the map, "
    "or of a revision that is still to come, all of them",
    "5f2b-91c0-1200",
    r"[ -~]{0,260}-[0-9]{1,18}",
    "<epoch>-<run>-<revision>",
)
UPDATES_PARAMETERS: Final = (SINCE,)


class MapUpdates:
    """What has changed of a live map. Any thread."""

    def __init__(
        self, live_map: ServedMap, cache: AnswerCache, large: LargeAnswers, in_flight: InFlight
    ) -> None:
        """`cache` keeps what is asked for, `large` and `in_flight` say whether there is room to make it."""
        self._map = live_map
        self._cache = cache
        self._large = large
        self._in_flight = in_flight

    def answer(self, given: Parameters) -> Answer:
        """The tiles that were written after the map `since`, or the whole map.

        Whole without `since`, and where that is another life of the map, or has not come yet.

        Raises:
            BadParameter: a parameter of another name, or `since` is no map's tag.
            Busy: it is large, and there is no memory or no thread left for it.
        """
        check_names(given, UPDATES_PARAMETERS)
        since = SINCE.read(given)
        key = UPDATES_FORMAT, since
        return self._cache.answer(
            *(key, self._map.now),
            lambda: self._large.making(self._cells(since)),
            lambda: self._made(since, key),
        )

    def _cells(self, since: str | None) -> int:
        """How many cells an answer looks at; of what has changed it is few."""
        return self._map.cells_in(None) if revision_seen(self._map.now, since) is None else 0

    def _made(self, since: str | None, key: object) -> Answer:
        snapshot = self._map.snapshot()
        seen = revision_seen(Identity.of(snapshot), since)
        changed = ChangedTiles.since(tiles_of(snapshot), seen or 0)
        with self._in_flight.making(bytes_to_tell(snapshot, changed)):
            updates = updates_of(snapshot, changed, seen or 0, whole=seen is None)
            body = b"".join(map(encode_update, updates))
        answer = Answer(body, MEDIA_TYPE, snapshot.meta())
        self._cache.keep(key, Identity.of(snapshot), answer)
        return answer


def tiles_of(snapshot: MapSnapshot) -> TileCopies:
    """The tiles of a live map's snapshot."""
    return cast(TileView, snapshot.stored).tiles


def bytes_to_tell(snapshot: MapSnapshot, changed: ChangedTiles) -> int:
    """What is held while changed tiles are encoded, at most: the stream twice, and a part's cells."""
    size = len(changed) * tile_bytes(snapshot.model.planes)
    return 2 * size + 2 * min(size, MAX_CELL_BYTES)


def revision_seen(now: Identity, since: str | None) -> int | None:
    """The revision that `since` names of this life; None of another, and of one that is still to come."""
    if since is None:
        return None
    life, _, revision = since.rpartition("-")
    if life != "-".join(now.life) or int(revision) > now.revision:
        return None
    return int(revision)
