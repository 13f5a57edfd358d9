"""Payloads of messages that others have made: encoded, and checked by the rules of who receives them."""

from collections.abc import Callable
from typing import TypeVar

from ogm_core.errors import BadMessage
from ogm_core.types import PoseStamped, Scan
from ogm_core.wire import messages

_M = TypeVar("_M")


def pose_payload(message: PoseStamped) -> bytes:
    """The bytes of a pose.

    Raises:
        BadMessage: a mapper would refuse it.
    """
    payload = _encoded(messages.encode_pose, message)
    messages.decode_pose(payload)
    return payload


def scan_payload(scan: Scan) -> bytes:
    """The bytes of a scan.

    Raises:
        BadMessage: a mapper would refuse it.
    """
    payload = _encoded(messages.encode_scan, scan)
    messages.decode_scan(payload)
    return payload


def _encoded(encode: Callable[[_M], bytes], message: _M) -> bytes:
    try:
        return encode(message)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadMessage(f"the message cannot be encoded: {error}") from error
