"""Guesses of a token: how many wrong ones an address may send, and how long it waits after too many."""

import ipaddress
import math
import time
from collections import OrderedDict
from collections.abc import Callable

AT_ONCE = 30
"""How many wrong tokens an address may send without a pause."""
PERIOD = 2.0
"""How long each of them is remembered, one after the other, s."""
MAX_ADDRESSES = 1024
"""Of so many addresses; who was wrong longest ago is forgotten first."""
_SHARED_BITS = 64
"""One customer's addresses of IPv6 have so many bits in common."""


class Guesses:
    """Counts wrong tokens by address. On the event loop only."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """`clock` in s."""
        self._clock = clock
        self._remembered_until: OrderedDict[str, float] = OrderedDict()

    def wait(self, address: str) -> int:
        """How long this address has to wait before its next token is looked at, s; 0: not at all."""
        until = self._remembered_until.get(_customer(address), 0.0)
        return max(0, math.ceil(until - self._clock() - (AT_ONCE - 1) * PERIOD))

    def wrong(self, address: str) -> None:
        """Note a wrong token."""
        who = _customer(address)
        before = self._remembered_until.pop(who, 0.0)
        self._remembered_until[who] = max(before, self._clock()) + PERIOD
        if len(self._remembered_until) > MAX_ADDRESSES:
            self._remembered_until.popitem(last=False)


def _customer(address: str) -> str:
    try:
        parsed = ipaddress.ip_address(address)
    except ValueError:
        return address
    if parsed.version == 4 or parsed.ipv4_mapped is not None:
        return address
    return str(ipaddress.ip_network((parsed, _SHARED_BITS), strict=False))
