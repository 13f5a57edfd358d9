"""Compilation that makes way for the process's end. Loads numba."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener

from ogm_services.runtime.signals import MakeWay


@contextmanager
def compiling_until(end: Callable[[], bool]) -> Iterator[None]:
    """Inside, what this thread compiles is given up, with MakeWay, once `end()` is true.

    numba asks before each of its passes, of which a kernel has some thirty; the longest takes a second.
    """
    with install_listener("numba:run_pass", _Look(end)):
        yield


class _Look(Listener):
    def __init__(self, end: Callable[[], bool]) -> None:
        self._end = end
        self._thread = threading.get_ident()

    def on_start(self, event: Event) -> None:
        if threading.get_ident() == self._thread and self._end():
            raise MakeWay

    def on_end(self, event: Event) -> None:
        pass
