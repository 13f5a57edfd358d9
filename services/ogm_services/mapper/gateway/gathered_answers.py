"""Gathered answers: what can be asked of a mapper, answered for the mappers of all shares of a map."""

import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

from ogm_core.errors import LimitReached
from ogm_core.lattice import CellRect, Region
from ogm_core.placing.receipts import Receipts
from ogm_core.snapshot import MapSnapshot
from ogm_core.status import MapInfo, MissingPart, ShareState, Status
from ogm_services.mapper.gateway.share_statuses import ShareStatuses
from ogm_services.mapper.gateway.summed_status import OVERLOAD, summed
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.map_formats import MAP_FORMATS, UPDATES_FORMAT
from ogm_services.mapper.serving.map_parameters import AT, COMPLETE, COMPLETE_FIRST, region_of
from ogm_services.mapper.serving.map_updates import SINCE
from ogm_services.mapper.serving.queries import Whole
from ogm_services.mapper.serving.query_parameters import ChoiceParameter, Parameter
from ogm_services.mapper.serving.saved_maps import SavedMaps
from ogm_services.mapper.shares.gathered_map import GatheredMap
from ogm_services.mapper.shares.gathered_views import GatheredView
from ogm_services.mapper.shares.gathering import Gathering
from ogm_services.mapper.shares.share_parts import MissingShare
from ogm_services.replies.answer import Answer, AskShares, Busy, OtherGateway, Parameters, PartOfMap

PLANNERS = frozenset({"pgm", "yaml"})
"""Formats that a planner loads, to which what is unknown may be free."""


class _Found(NamedTuple):
    """What there is of some cells."""

    missing: tuple[MissingShare, ...]
    """Shares whose cells are not there."""
    take: Callable[[], MapSnapshot] | None
    """What takes the map with what there is of them; None: that is the newest one."""


class GatheredAnswers(Answers):
    """Answers of a gateway: before each, the shares that it looks at are asked what has changed. Any thread.

    Of a map of which one of these is missing what is there is told, where an answer can say so. Others are
    refused.
    """

    def __init__(
        self,
        map_name: str,
        gathered: GatheredMap,
        gathering: Gathering,
        statuses: ShareStatuses,
        told: GatheredView,
        followed: GatheredView,
        receipts: Receipts,
        monitor: Monitor,
        ready: Callable[[], bool],
        memory: AnswerMemory,
        lives: Callable[[str], bool],
    ) -> None:
        """`told` and `followed` are the gathered map under its two names; `receipts` are of robots' poses.

        `lives` tells whether the gateway of a run lives.
        """
        super().__init__(map_name, told, receipts, monitor, ready, memory, followed=followed)
        self._name = map_name
        self._gathered = gathered
        self._gathering = gathering
        self._statuses = statuses
        self.map_tiles.tag = gathered.tags.tag
        self._lives = lives
        self._up_since = time.monotonic()

    @property
    def at_once(self) -> bool:
        """Not: whether the map is still the same its shares are to be asked."""
        return False

    @property
    def erases(self) -> bool:
        """Not by a gateway."""
        return False

    @property
    def saved(self) -> SavedMaps:
        """None.

        Raises:
            AskShares: as a gateway saves none.
        """
        raise AskShares("a gateway saves no maps, and restores none: its shares store theirs")

    def check_ready(self) -> None:
        """Refuse while the gateway starts; else bring the map up to date."""
        super().check_ready()
        self._gathering.gather()

    def whole(self, region: Region | None = None) -> Whole:
        """The map, of which nothing is missing in a region, None: at all.

        Raises:
            Starting: the gateway has not started.
            PartOfMap: a share is missing.
            Busy: the region takes more memory than is left.
        """
        self.check_started()
        return self._whole(self._cells_of(region))

    def _whole(self, cells: CellRect | None) -> Whole:
        found = self._gathered_on(cells)
        self._refuse_part(found.missing)
        return Whole(found.take or (lambda: self._held(cells)), live=found.take is None)

    def _held(self, cells: CellRect | None) -> MapSnapshot:
        """The newest map, if some cells, None: all, are still held: another thread may have gathered since.

        Raises:
            PartOfMap: they have become too many.
        """
        snapshot = self._map.snapshot()
        too_large = self._too_large(cells)
        if too_large:
            raise _does_not_fit(too_large)
        return snapshot

    def _too_large(self, cells: CellRect | None) -> frozenset[int]:
        """The shares of some cells, None: of all, that are not held."""
        not_held = self._gathered.state.not_held
        return not_held if cells is None else not_held & self._gathered.layout.met(cells)

    def _cells_of(self, region: Region | None) -> CellRect | None:
        """The cells that what is told of a region depends on, None: all.

        Raises:
            BadParameter: the region is inverted, empty or not finite.
        """
        return None if region is None else self._around(self._gathered.settings.lattice.cover(region))

    def _around(self, cells: CellRect) -> CellRect:
        """Some cells, and those around them as far as the model looks."""
        model = self._gathered.settings.cell_model
        # Halves of cells look farther than cells: as far as what is written into one is seen around it.
        return cells.widened(max(model.margin, model.spread))

    def _gathered_on(self, cells: CellRect | None) -> _Found:
        """What the shares have of some cells, None: of all.

        Raises:
            PartOfMap: nothing of them is there, as shares are missing: they are not outside the map.
            Busy: they take more memory than is left.
        """
        layout, gathering = self._gathered.layout, self._gathering
        shares: Collection[int] = range(layout.count) if cells is None else layout.met(cells)
        held = cells is None or not self._too_large(cells)
        try:
            if cells is None or held:
                found = gathering.gather(shares)
            else:
                found = gathering.gather_passing(cells, shares)
        except LimitReached as error:
            raise Busy(f"a region is too large: {error}") from error
        state, missing = found.state, found.missing_of(shares)
        if not missing:
            return _Found((), None if held else lambda: self._gathered.told(state))
        if cells is not None and not state.extent([each.share for each in missing]).meets(cells):
            self._refuse_part(missing)
        return _Found(missing, lambda: self._gathered.partial(state, missing))

    def _refuse_part(self, missing: Sequence[MissingShare]) -> None:
        """Refuse what would mislead without the shares that are missing, if there are any."""
        if not missing:
            return
        shares = [each.share for each in missing]
        if self._gathering.too_large.issuperset(shares):
            raise _does_not_fit(shares)
        names = ", ".join(map(str, shares))
        raise PartOfMap(f"share {names} of the map does not answer: ask again in a few seconds")

    def map_parameters(self, form: str) -> tuple[Parameter, ...]:
        """What a format of the map takes: `complete`, too."""
        return (*super().map_parameters(form), _complete(form))

    def map_of_all(self, form: str, given: Parameters) -> Answer:
        """`map`, where all gateways have been asked.

        Raises:
            OtherGateway: it asks what has changed since another one, which lives, told of the map.
        """
        since = SINCE.read(given) if form == UPDATES_FORMAT else None
        if since is not None:
            run = since.split("-")[-2]
            if run != self._gathered.run and self._lives(run):
                raise OtherGateway(f"map.tiles: the gateway of run {run} can say what has changed since")
        return self.map(form, given)

    def _map_now(self, form: str, given: Parameters) -> Answer:
        if form not in MAP_FORMATS:
            # Who follows keeps what he holds of a missing share: that has to be something.
            state, missing = self._gathering.gather()
            never = {share for share, part in enumerate(state.parts) if part is None} | state.not_held
            self._refuse_part([each for each in missing if each.share in never])
            return super()._map_now(form, given)
        whole = _complete(form).read(given) == "1"
        rest = {name: value for name, value in given.items() if name != COMPLETE.name}
        cells = self._cells_of(region_of(rest))
        found = self._gathered_on(cells)
        if whole:
            self._refuse_part(found.missing)
        if found.take is not None and AT.name not in rest:
            return self._maps.answer_of(found.take, form, rest)
        answer = super()._map_now(form, rest)
        # While it waited for its turn another gathering may have found that they are too many.
        return self._map_now(form, given) if self._too_large(cells) else answer

    def _with_cell(self, x: float, y: float) -> Whole:
        return self._whole(self._around(CellRect(*self._gathered.settings.lattice.cell_of(x, y), 1, 1)))

    def quality_fields(self, *, fresh: bool = False, within: float = math.inf) -> dict[str, Any]:
        """The quality figures of what is there; `missing_shares` names the shares that are not."""
        figures = super().quality_fields(fresh=fresh, within=within)
        scans = summed(self._share_statuses()).counts.scans.integrated
        figures |= {"scans": scans, "cell_updates": None}
        missing = self._gathering.newest.missing
        return figures | {"missing_shares": [each.described() for each in missing]} if missing else figures

    def status_since_start(self) -> Status:
        """Its status: sums of what shares have counted, who may have been started again."""
        return self.current_status()

    def _new_status(self) -> Status:
        statuses = self._share_statuses()
        sums, (state, missing) = summed(statuses), self._gathering.newest
        now, extent = state.named, state.extent()
        shares = [self._state_of(share, statuses.get(share)) for share in range(self._gathered.layout.count)]
        overload = any(status.scans.dropped.get(OVERLOAD, 0) for status in statuses.values())
        resolution = self._gathered.settings.resolution
        return Status(
            map=self._name,
            epoch=now.epoch,
            run=now.run,
            revision=now.revision,
            stamp=now.stamp,
            scans=sums.counts.scans,
            poses=sums.counts.poses,
            other=sums.counts.other,
            map_info=MapInfo(sums.known_cells, sums.bytes, extent.width, extent.height, resolution),
            robots=sums.counts.robots,
            uptime_s=time.monotonic() - self._up_since,
            shares=shares,
            missing=[MissingPart(each.share, list(each.bounds), each.since) for each in missing],
            complete=sums.balanced and not overload and len(statuses) == len(shares),
        )

    def _share_statuses(self) -> dict[int, Status]:
        """How the shares are that answer: it was just seen which of them do."""
        missing = {each.share for each in self._gathering.newest.missing}
        return self._statuses.ask(set(range(self._gathered.layout.count)) - missing)

    def _state_of(self, share: int, status: Status | None) -> ShareState:
        layout = self._gathered.layout
        newest = self._gathering.newest
        since = next((each.since for each in newest.missing if each.share == share), None)
        part = newest.state.parts[share]
        found = ShareState(
            share=share,
            bounds=list(layout.bounds(share)),
            state="up" if since is None else "missing",
            since=since,
            detail=self._gathering.refused.get(share),
        )
        if part is not None:
            found = replace(found, epoch=part.epoch, run=part.run, revision=part.revision)
        if status is not None:
            overload = status.scans.dropped.get(OVERLOAD, 0)
            found = replace(found, overload=overload, restored=status.restored)
            failing = None if status.store is None else status.store.failing
            if failing is not None and since is None:
                found = replace(found, state="not storing", detail=failing)
        return found


def _does_not_fit(shares: Collection[int]) -> PartOfMap:
    return PartOfMap(
        f"share {', '.join(map(str, sorted(shares)))} of the map does not fit into mapper.max_memory of this "
        "gateway: raise it, or ask for regions of the map"
    )


def _complete(form: str) -> ChoiceParameter:
    return COMPLETE_FIRST if form in PLANNERS else COMPLETE
