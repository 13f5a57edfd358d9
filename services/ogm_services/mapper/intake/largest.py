"""The largest of many changing values, found without a look at all of them."""

import heapq
from collections.abc import Callable, Iterable


class Largest:
    """Whose value is the largest, of values that change all the time.

    A heap of what each value once was. A value that has grown is told and put in anew; one that has shrunk is
    found out when it comes up: what the heap says is never too little.
    """

    def __init__(self, value_of: Callable[[str], float], names: Iterable[str]) -> None:
        self._value_of = value_of
        self._begin(names)

    def grew(self, name: str) -> None:
        """Take note that the value of `name`, which may be new, may have become larger."""
        value = self._value_of(name)
        if value > self._noted.get(name, 0.0):
            self._note(name, value)
            if len(self._heap) > 2 * len(self._noted) + 64:
                self._begin(list(self._noted))

    def name(self) -> str:
        """Whose value is the largest; there has to be one that is more than 0."""
        while True:
            noted, name = -self._heap[0][0], self._heap[0][1]
            value = self._value_of(name)
            if value >= noted:
                return name
            heapq.heappop(self._heap)
            if self._noted.get(name) == noted:
                del self._noted[name]
                if value > 0.0:
                    self._note(name, value)

    def _begin(self, names: Iterable[str]) -> None:
        self._noted = {name: value for name in names if (value := self._value_of(name)) > 0.0}
        self._heap = [(-value, name) for name, value in self._noted.items()]
        heapq.heapify(self._heap)

    def _note(self, name: str, value: float) -> None:
        self._noted[name] = value
        heapq.heappush(self._heap, (-value, name))
