"""Gathering up of messages: where many come, each by itself, the worker takes them a few at a time."""

import time
from collections import deque

OFTEN = 32
OFTEN_SECONDS = 0.064
"""So many messages within so long, s: to wake a thread for each takes longer than to handle it."""
PAUSE = 0.004
"""For so long they gather then, s."""


class GatheringUp:
    """Lets messages gather where many come. The worker's alone; whoever puts some waits for nobody."""

    def __init__(self) -> None:
        self._arrivals: deque[float] = deque(maxlen=OFTEN)
        """Of the messages that were handled last, s."""

    def handled(self, arrival: float) -> None:
        """Note a message that came at that moment, s."""
        self._arrivals.append(arrival)

    def is_worth_while(self, now: float) -> bool:
        """Whether so many have come of late that more will while the worker sleeps."""
        return len(self._arrivals) == OFTEN and now - self._arrivals[0] < OFTEN_SECONDS

    def pause(self) -> None:
        """Sleep while they gather."""
        time.sleep(PAUSE)
