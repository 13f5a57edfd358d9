"""The mapper's routes on Zenoh: queryables over `Answers`."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from itertools import islice

import zenoh

from ogm_core.errors import BadParameter
from ogm_core.wire.keys import MapKeys, Write
from ogm_services.mapper.serving.answering_threads import AnsweringThreads
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.checks import MAX_BODY
from ogm_services.mapper.serving.writes import DoWrite
from ogm_services.replies.answer import Answer, Parameters
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.queryables import Queryables

TRUTH_TIMEOUT = 0.5
"""How long simulators may take to tell their world, s."""
MAX_TOLD = 16
"""So many answers about the true world are looked at, whoever gives them."""


class ZenohRoutes:
    """What a mapper declares on a session to be asked, until `close`.

    Zenoh's threads call the callbacks, which hand their query to the threads that answer its kind.
    """

    def __init__(self, session: zenoh.Session, keys: MapKeys, in_flight: InFlight | None = None) -> None:
        self._session = session
        self._keys = keys
        self._declared = ExitStack()
        self._queryables = Queryables(session, in_flight)

    def declare(self, answers: Answers, writes: Mapping[Write, DoWrite], threads: AnsweringThreads) -> None:
        """Declare the queryables: from here on every question gets an answer, by these `threads`."""
        self._declared.callback(self._queryables.close)
        declare, key = self._queryables.declare, self._keys.service
        declare(key("map"), _in_format(answers.map_of_all, "json"), threads.maps)
        declare(key("cell"), answers.cell, threads.maps)
        declare(key("quality"), answers.quality, threads.maps)
        declare(key("status"), answers.status, threads.status)
        declare(key("snapshots"), answers.snapshots, threads.maps)
        declare(key("raycast"), answers.queries.raycast, threads.maps)
        # Nobody who asks for whatever there is has them computed: they take long.
        declare(key("distance"), _in_format(answers.queries.distance), threads.maps)
        declare(key("inflate"), _in_format(answers.queries.inflate), threads.maps)
        self._queryables.declare_with_body(key("check"), answers.queries.check, threads.maps, MAX_BODY)
        for name, write in writes.items():
            declare(key(name), partial(write, who="somebody over Zenoh"), threads.writes, exact=True)

    def declare_share(
        self,
        index: int,
        part: Callable[[Parameters], Answer],
        status: Callable[[Parameters], Answer],
        reset: DoWrite,
        threads: AnsweringThreads,
    ) -> None:
        """Declare what share `index` of a map that is cut is asked for, in place of all that a map is."""
        self._declared.callback(self._queryables.close)
        declare = self._queryables.declare
        declare(self._keys.share(index, "part"), part, threads.maps)
        declare(self._keys.share(index, "status"), status, threads.status)
        done = partial(reset, who="somebody over Zenoh")
        declare(self._keys.share(index, "reset"), done, threads.writes, exact=True)

    def ask_truth(self) -> list[zenoh.ZBytes]:
        """What simulators of this map say their world is, MAX_TOLD at most; [] at once if there is none.

        Waits for the network, up to TRUTH_TIMEOUT: never call it from a callback.
        """
        # All of them are asked and heard: with one reply a key, which one it is would be chance.
        replies = self._session.get(
            self._keys.truth,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=TRUTH_TIMEOUT,
        )
        return list(islice((reply.ok.payload for reply in replies if reply.ok is not None), MAX_TOLD))

    def close(self) -> None:
        """Undeclare everything; who closes the threads sees to the queries that have come."""
        self._declared.close()


def _in_format(
    made: Callable[[str, Parameters], Answer], default: str | None = None
) -> Callable[[Parameters], Answer]:
    """What is made in a format, for queries that name it in a parameter; without a default they must."""

    def answer(given: Parameters) -> Answer:
        form = given.get("format", default)
        if form is None:
            raise BadParameter("format: missing: it says in which one the answer is to be")
        return made(form, {name: value for name, value in given.items() if name != "format"})

    return answer
