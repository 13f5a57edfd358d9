"""Answers of shares: every share of a map is asked at once, and what comes in time is taken."""

import queue
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import msgpack
import zenoh

from ogm_core.wire.keys import MapKeys, ShareService

MAX_ATTACHMENT = 4096
_AT_ONCE = 0.001
"""The least time that is given, s: Zenoh takes 0 for its own default."""


_Heard = queue.SimpleQueue[tuple[int, zenoh.Reply | None]]


class ShareAnswer(NamedTuple):
    """What a mapper has answered that says it is a share."""

    share: int
    payload: bytes
    told: Mapping[str, object]
    """What goes with a part: which share of which map it is. Empty if that is ill-formed."""
    refused: bool
    """Whether the payload says why there is no answer."""


def ask_shares(
    session: zenoh.Session,
    keys: MapKeys,
    service: ShareService,
    asked: Mapping[int, str],
    timeout: float,
) -> Iterator[ShareAnswer]:
    """Ask shares, each with its parameters, and yield what comes, in any order, for `timeout` s at most.

    It ends as soon as every mapper that Zenoh knows has answered. Two mappers of a share both answer.
    """
    heard: _Heard = queue.SimpleQueue()
    deadline = time.monotonic() + max(timeout, _AT_ONCE)
    for share, parameters in asked.items():
        handler = _handler(heard, share)
        session.get(
            zenoh.Selector(keys.share(share, service), parameters),
            handler,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=max(timeout, _AT_ONCE),
        )
    open_questions = len(asked)
    while open_questions:
        try:
            share, reply = heard.get(timeout=max(deadline - time.monotonic(), _AT_ONCE))
        except queue.Empty:
            return
        if reply is None:
            open_questions -= 1
        elif reply.ok is not None:
            yield ShareAnswer(share, reply.ok.payload.to_bytes(), _told(reply.ok.attachment), refused=False)
        elif reply.err is not None:
            yield ShareAnswer(share, reply.err.payload.to_bytes(), {}, refused=True)


def _handler(heard: _Heard, share: int) -> "zenoh.handlers.Callback[zenoh.Reply]":
    """What puts down the replies of a share, and, with None, that there are no more."""
    return zenoh.handlers.Callback(
        lambda reply: heard.put((share, reply)), lambda: heard.put((share, None)), indirect=False
    )


def _told(attachment: zenoh.ZBytes | None) -> Mapping[str, object]:
    if attachment is None or len(attachment) > MAX_ATTACHMENT:
        return {}
    try:
        told = msgpack.unpackb(attachment.to_bytes())
    except (ValueError, TypeError, OverflowError, RecursionError, msgpack.UnpackException):
        return {}
    return told if isinstance(told, dict) else {}
