"""How a command loads what it needs."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from ogm_services.runtime.signals import held_signals


@contextmanager
def loading() -> Iterator[None]:
    """Import modules inside: signals are put off, and nothing is searched for garbage.

    There is next to none among modules, and searching them takes a tenth of the time. Nor are they searched
    later, which would hold up every thread of a service for as long.
    """
    gc.disable()
    try:
        with held_signals():
            yield
    finally:
        gc.freeze()
        gc.enable()
