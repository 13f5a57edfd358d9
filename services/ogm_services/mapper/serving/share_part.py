"""Part of a map: what the mapper of one share tells who gathers the map, its cells as they are stored."""

from typing import Any

from ogm_core.lattice import Region
from ogm_core.status import ShareInfo
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import MEDIA_TYPE, encode_update
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.serving.answer_cache import AnswerCache
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.map_parameters import REGION, region_of
from ogm_services.mapper.serving.map_updates import SINCE, bytes_to_tell, revision_seen, tiles_of
from ogm_services.mapper.serving.query_parameters import check_names
from ogm_services.mapper.storage.map_settings import as_text
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.in_flight import InFlight

PART_PARAMETERS = REGION, SINCE


class SharePart:
    """The cells of one share, for who gathers the map. Any thread."""

    def __init__(self, share: ShareInfo, live_map: LiveMap, answers: Answers, in_flight: InFlight) -> None:
        """`answers`: those of the same map. `in_flight` says whether there is memory to make another."""
        self._share = share
        self._map = live_map
        self._settings = as_text(live_map.settings)
        self._answers = answers
        self._in_flight = in_flight
        self._cache = AnswerCache(answers.now, answers.memory.cache_room)
        answers.memory.count(self._cache)

    def answer(self, given: Parameters) -> Answer:
        """The tiles in a region that were written after the revision `since`, or all tiles in it.

        All without `since`, and where that is another life of the share, or has not come yet.

        Raises:
            Starting: the mapper is not ready.
            BadParameter: a parameter is unknown or ill-formed.
            Busy: there is no memory left for it.
        """
        self._answers.check_ready()
        check_names(given, PART_PARAMETERS)
        region, since = region_of(given), SINCE.read(given)
        if region is not None:
            self._map.cells_in(region)  # refuses one that is inverted
        key = region, since
        now = self._map.now
        answer = self._cache.find(key, now)
        if answer is None:
            with self._cache.turn(key):
                answer = self._cache.find(key, now) or self._made(region, since, key)
        return answer

    def _made(self, region: Region | None, since: str | None, key: object) -> Answer:
        snapshot = self._map.snapshot()
        seen = revision_seen(Identity.of(snapshot), since)
        changed = ChangedTiles.since(tiles_of(snapshot), seen or 0)
        if region is not None:
            changed = changed.meeting(snapshot.lattice.cover(region))
        with self._in_flight.making(bytes_to_tell(snapshot, changed)):
            updates = updates_of(snapshot, changed, seen or 0, whole=seen is None)
            body = b"".join(map(encode_update, updates))
        answer = Answer(body, MEDIA_TYPE, snapshot.meta() | self._told())
        self._cache.keep(key, Identity.of(snapshot), answer)
        return answer

    def _told(self) -> dict[str, Any]:
        share = self._share
        return {
            "share": share.index,
            "shares": share.shares,
            "cuts_x": share.cuts_x,
            "cuts_y": share.cuts_y,
            "settings": self._settings,
        }
