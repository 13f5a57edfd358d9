"""Locator of compiled kernels in a folder that several processes fill at once. Numba loads it, by its name.

Numba numbers the compiled versions of a kernel, and picks the number before it writes: of two processes that
compile one kernel for different types at once, either may later find the other's machine code under its own
types, and run it. So a process writes under names that no other has; at worst, one of the two compiles again.
"""

import os
import secrets
from typing import Any

from numba.core.caching import IndexDataCacheFile, UserProvidedCacheLocator

# numba has no public place for the names; without this one, loading the locator fails, and says so
_numbered: Any = IndexDataCacheFile._data_name  # noqa: SLF001
_writers: dict[int, str] = {}


def _of_this_process(kernel: IndexDataCacheFile, number: int) -> str:
    """Name of the file for a kernel's version."""
    writer = _writers.setdefault(os.getpid(), secrets.token_hex(8))  # a fork is another process
    return f"{_numbered(kernel, number).removesuffix('.nbc')}.{writer}.nbc"


setattr(IndexDataCacheFile, "_data_name", _of_this_process)  # noqa: B010


class KernelFiles(UserProvidedCacheLocator):
    """Locator (numba: cache locator class) of kernels in NUMBA_CACHE_DIR, and nowhere else."""
