"""Services that are offered to robots over Zenoh: a queryable, and the token that tells of it."""

from collections.abc import Callable
from contextlib import ExitStack, suppress

import zenoh

from ogm_services.ros2.topic_source import TakeRequest


class ZenohService:
    """A service under a key, until it is closed."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        token: str,
        take: TakeRequest,
        attached: Callable[[bytes], bytes] | None = None,
    ) -> None:
        """`attached`: what goes with a reply, made of what came with the request; None: nothing."""

        def taken(query: zenoh.Query) -> None:
            take(ZenohRequest(query, attached))

        handler = zenoh.handlers.Callback(taken, indirect=False)
        with ExitStack() as opening:
            # Clients ask those alone who say that they have all.
            opening.push(session.declare_queryable(key, handler, complete=True))
            alive = session.liveliness().declare_token(token)
            opening.callback(alive.undeclare)
            self._open = opening.pop_all()

    def close(self) -> None:
        """Offer it no more."""
        self._open.close()


class ZenohRequest:
    """A query that waits for the reply; one that nobody waits for any more is let go."""

    def __init__(self, query: zenoh.Query, attached: Callable[[bytes], bytes] | None) -> None:
        self._query, self._attached = query, attached

    def answer(self, payload: bytes) -> None:
        """Reply with a message's CDR."""
        came = self._query.attachment
        goes = self._attached(came.to_bytes()) if self._attached and came is not None else None
        with suppress(zenoh.ZError), self._query as query:
            query.reply(query.key_expr, payload, attachment=goes)

    def refuse(self, why: str) -> None:
        """Say that there is no reply."""
        with suppress(zenoh.ZError), self._query as query:
            query.reply_err(why)
