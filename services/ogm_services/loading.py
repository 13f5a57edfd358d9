"""How a command loads what it needs: in one go, and no more than that."""

import gc
import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ogm_services.exit_codes import held_signals


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


def load_numba() -> None:
    """Load numba, and what it loads with the first kernel, without scipy's linear algebra.

    numba looks for it at that moment, for products of matrices, and importing it takes longer than all
    kernels together. None of them multiplies matrices. Call it before there are other threads, for it hides
    the module that they might want.
    """
    name = "scipy.linalg"
    if name in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment]  # importing it now fails, as if it were not there
    try:
        importlib.import_module("numba.np.arraymath")
    finally:
        del sys.modules[name]
