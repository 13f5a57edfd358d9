"""Lazy imports of a command: how it loads what it needs."""

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ogm_services.runtime.signals import MakeWay, held_signals


@contextmanager
def loading() -> Iterator[None]:
    """Import modules inside: signals wait for the next module, and nothing is searched for garbage.

    There is next to none among modules, and searching them takes a tenth of the time. Nor are they searched
    later, which would hold up every thread of a service for as long.
    """
    gc.disable()
    try:
        with held_signals() as held, _no_more_once(held):
            yield
    finally:
        gc.freeze()
        gc.enable()


@contextmanager
def _no_more_once(held: list[int]) -> Iterator[None]:
    """No module is looked for once there is a signal."""
    look = _Look(held)
    sys.meta_path.insert(0, look)
    try:
        yield
    except Exception as error:
        if not held:
            raise
        raise MakeWay from error  # of which a library has made an error of its own
    finally:
        sys.meta_path.remove(look)


class _Look:
    """Finder of modules that finds none, but is asked first."""

    def __init__(self, held: list[int]) -> None:
        self._held = held

    def find_spec(self, *_: object) -> None:
        if self._held:
            raise MakeWay
