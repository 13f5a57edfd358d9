"""Gathering: asks every share of a map what has changed, and says which of them do not answer."""

import logging
import threading
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import zenoh

from ogm_core.errors import BadMessage, LimitReached, OgmError, printable
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.map_update import MapUpdate, decode_updates
from ogm_services.mapper.shares.gathered_map import Gathered, GatheredMap, OtherMap
from ogm_services.mapper.shares.share_answers import Asked, ShareAnswer, ask_shares
from ogm_services.mapper.shares.share_parts import MissingShare
from ogm_services.runtime.limited_log import LimitedLog

LEAST = 0.05
"""A share that has kept silent is waited for so long at least, s, by who has waited for that already."""

log = logging.getLogger(__name__)


class Result(NamedTuple):
    """What a gathering has found."""

    state: Gathered
    missing: tuple[MissingShare, ...]


class Gathering:
    """Brings a gathered map up to date when it is asked to. Any thread; one gathers at a time.

    Who waits while another gathers takes what the next gathering finds, which begins after his question.
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
        self._gathering = threading.Lock()
        self._begun = float("-inf")
        self._runs: dict[int, list[str]] = {}
        """By share, its processes in the order in which they were first heard: of two the newer counts."""
        self._since: dict[int, int] = {}
        """Since when shares are missing, ns since the Unix epoch."""
        self._refused: dict[int, str] = {}
        """Why what a share tells is not taken."""
        self._log = LimitedLog(log)
        self.newest = Result(gathered.state, self._all_missing())
        """What was found last; any thread."""

    def gather(self) -> Result:
        """The map as its shares have it now, those that answer in time."""
        asked = self._clock()
        with self._gathering:
            if self._begun < asked:
                self._begun = self._clock()
                left = asked + self._timeout - self._begun
                self.newest = self._ask(min(max(left, LEAST), self._timeout))
            return self.newest

    @property
    def refused(self) -> Mapping[int, str]:
        """Why what some shares tell is not taken."""
        return dict(self._refused)

    def _all_missing(self) -> tuple[MissingShare, ...]:
        shares = range(self._gathered.layout.count)
        self._since = dict.fromkeys(shares, time.time_ns())
        return self._missing()

    def _missing(self) -> tuple[MissingShare, ...]:
        layout = self._gathered.layout
        return tuple(
            MissingShare(share, layout.bounds(share), since) for share, since in sorted(self._since.items())
        )

    def _ask(self, silent_for: float) -> Result:
        """Gather; those that did not answer the gathering before are waited for `silent_for` s alone."""
        asked = {
            share: Asked(
                f"since={part.tag}" if part else "", silent_for if share in self._since else self._timeout
            )
            for share, part in enumerate(self._gathered.state.parts)
        }
        taken: dict[int, str] = {}
        older: list[tuple[int, list[MapUpdate]]] = []
        for answer in ask_shares(self._session, self._keys, "part", asked):
            try:
                updates = self._read(answer)
            except OgmError as error:
                self._refuse(answer.share, error)
                continue
            # Of a process that has been replaced nothing is taken, unless the other keeps silent.
            held = self._gathered.state.parts[answer.share]
            if held is not None and self._is_older(answer.share, updates[0].run, held.run):
                older.append((answer.share, updates))
            else:
                self._take(answer.share, updates, taken)
        for share, updates in older:
            if share not in taken:
                self._take(share, updates, taken)
        self._note(taken)
        return Result(self._gathered.state, self._missing())

    def _take(self, share: int, updates: list[MapUpdate], taken: dict[int, str]) -> None:
        """Take a part, and note in `taken` whose it is."""
        try:
            self._gathered.take(share, updates)
        except OgmError as error:
            self._refuse(share, error)
        else:
            taken[share] = updates[0].run
            self._refused.pop(share, None)

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
        self._refused[share] = str(error)
        if isinstance(error, OtherMap | LimitReached):
            self._log.warning(f"share {share}", f"what it tells is not taken: {error}")

    def _note(self, heard: Mapping[int, str]) -> None:
        """Note which shares are missing, and tell when that changes."""
        for share in range(self._gathered.layout.count):
            if share in heard and self._since.pop(share, None) is not None:
                log.info("share %d answers", share)
            elif share not in heard and share not in self._since:
                self._since[share] = time.time_ns()
                log.warning("share %d does not answer: its part of the map is missing", share)
