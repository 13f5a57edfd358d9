"""Gathering: asks every share of a map what has changed, and says which of them do not answer."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

import zenoh

from ogm_core.errors import BadMessage, LimitReached, OgmError, printable
from ogm_core.lattice import CellRect
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.map_update import MapUpdate, decode_updates
from ogm_services.mapper.shares.gathered_map import Gathered, GatheredMap, OtherMap
from ogm_services.mapper.shares.share_answers import Asked, ShareAnswer, ask_shares
from ogm_services.mapper.shares.share_parts import MissingShare
from ogm_services.runtime.limited_log import LimitedLog

LEAST = 0.05
"""A share that has kept silent is waited for so long at least, s, by who has waited for that already."""

BESIDE = "region=1e300,1e300,2e300,2e300"
"""What a share is asked for that is to tell how far it is, and no cells."""

log = logging.getLogger(__name__)


class Result(NamedTuple):
    """What gathering has found."""

    state: Gathered
    missing: tuple[MissingShare, ...]

    def missing_of(self, shares: Collection[int]) -> tuple[MissingShare, ...]:
        """Those of some shares that are missing."""
        return tuple(each for each in self.missing if each.share in shares)


class Gathering:
    """Brings a gathered map up to date, all of it or some shares, when it is asked to. Any thread.

    Who owns what: a share is asked by one thread at a time, which alone changes what is noted of it, under
    `_turns`. Who wants it meanwhile takes what the next question finds, which begins after his own. So a
    share that keeps silent holds up nobody but those who want it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        keys: MapKeys,
        gathered: GatheredMap,
        timeout: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Each share may take `timeout` s to answer."""
        self._session = session
        self._keys = keys
        self._gathered = gathered
        self._timeout = timeout
        self._clock = clock
        self._shares = range(gathered.layout.count)
        self._turns = threading.Condition()
        self._begun = dict.fromkeys(self._shares, float("-inf"))
        """When each share was asked last, by the clock."""
        self._too_large: set[int] = set()
        self._asking: set[int] = set()
        """Those that a thread is asking now."""
        self._runs: dict[int, list[str]] = {}
        """By share, its processes in the order in which they were first heard: of two the newer counts."""
        self._since = dict.fromkeys(self._shares, time.time_ns())
        """Since when shares are missing, ns since the Unix epoch: at first all of them."""
        self._told_missing = set(self._shares)
        """Those of which the log says that they are missing, or has not said yet that they answer."""
        self._refused: dict[int, str] = {}
        """Why what a share tells is not taken."""
        self._log = LimitedLog(log)

    def gather(self, shares: Collection[int] | None = None) -> Result:
        """The map as some of its shares have it now, None: all, those that answer in time."""
        asked, wanted = self._clock(), self._shares if shares is None else shares
        while True:
            with self._turns:
                self._turns.wait_for(lambda: self._free(wanted, asked) or not self._left(wanted, asked))
                mine = self._free(wanted, asked)
                if not mine:
                    return self.newest
                begun = self._clock()
                self._begun.update(dict.fromkeys(mine, begun))
                self._asking.update(mine)
            try:
                # Who has waited for his turn has waited for those, too, that kept silent meanwhile.
                self._ask(mine, min(max(asked + self._timeout - begun, LEAST), self._timeout))
            finally:
                self._end_turns(mine)

    def gather_passing(self, cells: CellRect, shares: Collection[int]) -> Result:
        """Some cells of a map as some shares have it now; none of them are held afterwards.

        Raises:
            LimitReached: there is no memory for them.
        """
        bounds = self._gathered.settings.lattice.region_of(cells)
        asked = Asked(f"region={','.join(map(repr, bounds))}", self._timeout)
        runs = {part.run for part in self._gathered.state.parts if part is not None}
        found, missing = self._gathered.passing(self._gathered.left), set(shares)
        for share, answers in ask_shares(self._session, self._keys, "part", dict.fromkeys(shares, asked)):
            # Of two processes of a share the one that is known comes last, and counts.
            for updates in sorted(self._all_read(share, answers), key=lambda each: each[0].run in runs):
                try:
                    found.take(share, updates)
                except OtherMap as error:
                    self._refuse(share, error)
                else:
                    missing.discard(share)
        state = self._gathered.state
        parts = tuple(new or known for new, known in zip(found.state.parts, state.parts, strict=True))
        with self._turns:
            self._too_large -= missing
            since = {share: self._since.get(share, time.time_ns()) for share in missing}
        return Result(Gathered.of(parts, found.state.copies, state.not_held), self._described(since))

    @property
    def newest(self) -> Result:
        """What is known now, without asking anybody."""
        with self._turns:
            return Result(self._gathered.state, self._described(self._since))

    @property
    def refused(self) -> Mapping[int, str]:
        """Why what some shares tell is not taken."""
        with self._turns:
            return dict(self._refused)

    @property
    def too_large(self) -> frozenset[int]:
        """Shares that have answered, and are not held for want of memory: they are missing, too."""
        with self._turns:
            return frozenset(self._too_large)

    def _described(self, since: Mapping[int, int]) -> tuple[MissingShare, ...]:
        bounds = self._gathered.layout.bounds
        return tuple(MissingShare(share, bounds(share), when) for share, when in sorted(since.items()))

    def _left(self, wanted: Collection[int], asked: float) -> list[int]:
        """Those of some shares of which nothing newer than a question is known; `_turns` is held."""
        return [share for share in wanted if share in self._asking or self._begun[share] < asked]

    def _free(self, wanted: Collection[int], asked: float) -> list[int]:
        """Those of them that nobody is asking; `_turns` is held."""
        return [share for share in self._left(wanted, asked) if share not in self._asking]

    def _end_turns(self, shares: Collection[int]) -> None:
        with self._turns:
            self._asking.difference_update(shares)
            self._turns.notify_all()

    def _ask(self, shares: Collection[int], silent_for: float) -> None:
        """Ask shares; those that did not answer the last time are waited for `silent_for` s alone."""
        missing = {each.share for each in self.newest.missing}
        asked = {
            share: Asked(self._wanted_of(share), silent_for if share in missing else self._timeout)
            for share in shares
        }
        for share, answers in ask_shares(self._session, self._keys, "part", asked):
            heard = self._take_newest(share, answers)
            answered = any(not answer.refused for answer in answers)
            too_large = answered and share in self._gathered.state.not_held
            if not answers and share not in self._gathered.state.not_held:
                with self._turns:
                    self._refused.pop(share, None)  # what it told once is not why it is missing now
            self._note(share, heard=heard, too_large=too_large)
            self._end_turns([share])

    def _wanted_of(self, share: int) -> str:
        """What a share is asked for, as parameters."""
        state = self._gathered.state
        if share in state.not_held:
            return BESIDE
        part = state.parts[share]
        return "" if part is None else f"since={part.tag}"

    def _take_newest(self, share: int, answers: Sequence[ShareAnswer]) -> bool:
        """Take what the newest process of a share has answered; whether there was any."""
        taken, older = False, []
        for updates in self._all_read(share, answers):
            # Of a process that has been replaced nothing is taken, unless the other keeps silent.
            held = self._gathered.state.parts[share]
            if held is not None and self._is_older(share, updates[0].run, held.run):
                older.append(updates)
            else:
                taken |= self._take(share, updates)
        for updates in older:
            taken = taken or self._take(share, updates)
        return taken

    def _take(self, share: int, updates: list[MapUpdate]) -> bool:
        """Take a part, if it can be."""
        if share in self._gathered.state.not_held:
            self._gathered.note(share, updates)
            return False  # why not has been said
        try:
            self._gathered.take(share, updates)
        except OgmError as error:
            self._refuse(share, error)
            return False
        with self._turns:
            self._refused.pop(share, None)
        return True

    def _all_read(self, share: int, answers: Sequence[ShareAnswer]) -> Iterator[list[MapUpdate]]:
        """What can be taken of what a share's processes have answered; of the rest it is noted why not."""
        for answer in answers:
            try:
                updates = self._read(answer)
            except OgmError as error:
                self._refuse(share, error)
            else:
                yield updates

    def _read(self, answer: ShareAnswer) -> list[MapUpdate]:
        """The messages of a part.

        Raises:
            OgmError: it is none, or of another map.
        """
        if answer.refused:
            raise BadMessage(printable(answer.payload[:300].decode(errors="replace")))
        self._gathered.check_share(answer.share, answer.told)
        updates = list(decode_updates(answer.payload))
        if not updates or [update.part for update in updates] != list(range(updates[0].parts)):
            raise BadMessage(f"{len(updates)} messages are not all of a part")
        return updates

    def _is_older(self, share: int, run: str, held: str) -> bool:
        """Whether a process of a share was heard of before the one whose part is held."""
        runs = self._runs.setdefault(share, [held])
        if run not in runs:
            runs.append(run)
        return held in runs and runs.index(run) < runs.index(held)

    def _refuse(self, share: int, error: OgmError) -> None:
        with self._turns:
            self._refused[share] = str(error)
        if isinstance(error, OtherMap | LimitReached):
            self._log.warning(f"share {share}", f"what it tells is not taken: {error}")

    def _note(self, share: int, *, heard: bool, too_large: bool) -> None:
        """Note whether a share is missing; tell when it answers again, and when it was silent twice in a row.

        On a busy machine one answer of a share that is well may come too late. One that answers, and is
        `too_large` to be held, is missing all the same: why has been said.
        """
        with self._turns:
            (self._too_large.add if too_large else self._too_large.discard)(share)
            if too_large:
                self._told_missing.discard(share)
                self._since.setdefault(share, time.time_ns())
                return
            if heard:
                self._since.pop(share, None)
                changed = share in self._told_missing
                self._told_missing.discard(share)
            else:
                changed = share in self._since and share not in self._told_missing
                if changed:
                    self._told_missing.add(share)
                self._since.setdefault(share, time.time_ns())
        if changed and heard:
            log.info("share %d answers", share)
        elif changed:
            log.warning("share %d does not answer: its part of the map is missing", share)
