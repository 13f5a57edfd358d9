"""Answers of shares: every share of a map is asked at once, and what comes in time is taken."""

import queue
import time
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import msgpack
import zenoh

from ogm_core.wire.keys import MapKeys, ShareService

MAX_ATTACHMENT = 4096
_TIMED_OUT = b"Timeout"
"""Zenoh's own error reply, when a queryable took the query and did not finish in time."""
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


class Asked(NamedTuple):
    """What a share is asked for, as parameters, and how long it is waited for, s."""

    parameters: str
    timeout: float


def ask_shares(
    session: zenoh.Session, keys: MapKeys, service: ShareService, asked: Mapping[int, Asked]
) -> Iterator[tuple[int, list[ShareAnswer]]]:
    """Ask shares at once, and yield each, in any order, with what it has answered in time.

    A share is through as soon as every mapper of it that Zenoh knows has answered: two of one share both do.
    """
    heard: _Heard = queue.SimpleQueue()
    begun, until = time.monotonic(), {}
    replies: dict[int, list[zenoh.Reply]] = {share: [] for share in asked}
    for share, (parameters, timeout) in asked.items():
        until[share] = begun + max(timeout, _AT_ONCE)
        session.get(
            zenoh.Selector(keys.share(share, service), parameters),
            _handler(heard, share),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=max(timeout, _AT_ONCE),
        )
    while until:
        # To the last one that is waited for.
        try:
            share, reply = heard.get(timeout=max(max(until.values()) - time.monotonic(), _AT_ONCE))
        except queue.Empty:
            break
        if reply is None:
            del until[share]
            yield share, _read(share, replies[share])
        else:
            replies[share].append(reply)
    yield from ((share, _read(share, replies[share])) for share in until)


def _read(share: int, replies: list[zenoh.Reply]) -> list[ShareAnswer]:
    """The answers in some replies; copied only now, so that they are not far from who decodes them."""
    read = []
    for reply in replies:
        if reply.ok is not None:
            body, told = reply.ok.payload.to_bytes(), _told(reply.ok.attachment)
            read.append(ShareAnswer(share, body, told, refused=False))
        elif reply.err is not None and reply.err.payload.to_bytes() != _TIMED_OUT:
            read.append(ShareAnswer(share, reply.err.payload.to_bytes(), {}, refused=True))
    return read


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
