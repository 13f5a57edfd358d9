"""Error replies to queries, sent by a thread of their own: a link that stands still blocks its senders.

Its own are that thread and its bounds; the body is that of `replies/problems.py`.
"""

import logging
import queue
import threading

import zenoh

from ogm_core.errors import OgmError
from ogm_services.replies.problems import MEDIA_TYPE, problem, problem_of
from ogm_services.runtime.limited_log import LimitedLog

MAX_UNTOLD = 1024
"""So many queries may wait to be told; more get no reply, on links where nothing moves anyway."""
MAX_LARGE = 4
"""So many wait of those that are large themselves."""

log = logging.getLogger(__name__)


class ErrorReplies:
    """Tells queries what went wrong, until `close`. Any thread; only its own one waits for links."""

    def __init__(self, waiting: int = MAX_UNTOLD) -> None:
        self._room = waiting
        self._waiting: queue.SimpleQueue[tuple[zenoh.Query, bytes] | None] = queue.SimpleQueue()
        self._log = LimitedLog(log)
        self._closing = threading.Lock()
        self._closed = False
        # A daemon: where nobody closes, it keeps no process from ending.
        self._thread = threading.Thread(target=self._send, name="ogm-error-replies", daemon=True)
        self._thread.start()

    def tell(self, query: zenoh.Query, error: BaseException, *, large: bool = False) -> None:
        """Have a query told why it has no answer; a bug is logged, and told without its innards.

        `large`: the query itself takes memory while it waits.
        """
        if isinstance(error, OgmError):
            body = problem_of(error)
        else:
            log.error("a query of %s failed", query.key_expr, exc_info=error)
            body = problem("internal", 500, "the service failed; see its log")
        with self._closing:
            most = MAX_LARGE if large else self._room
            closed, room = self._closed, self._waiting.qsize() < most
            if not closed and room:
                self._waiting.put((query, body))
        if closed:
            _reply(query, body)
        elif not room:
            with query:  # it ends without a reply
                pass
            self._log.warning("error replies", f"{most} wait to be sent: a query gets none")

    def close(self) -> None:
        """Send those that wait; later ones are sent by whoever tells them."""
        with self._closing:
            self._closed = True
        self._waiting.put(None)
        self._thread.join()

    def _send(self) -> None:
        while (told := self._waiting.get()) is not None:
            _reply(*told)


def _reply(query: zenoh.Query, body: bytes) -> None:
    try:
        with query:
            query.reply_err(body, encoding=MEDIA_TYPE)
    except Exception:
        # Its session or link is gone: there is nobody to tell.
        log.debug("an error reply was not sent", exc_info=True)
