"""Files of compiled kernels in a folder that several processes fill at once. Numba loads it, by its name.

Numba numbers the compiled versions of a kernel, and picks the number before it writes: of two processes that
compile one kernel for different types at once, either may later find the other's machine code under its own
types, and run it. So a process writes under names that no other has; at worst, one of them compiles again.

Nor does numba expect files that a power cut has left half written, or a disk that is full. What cannot be
read is compiled again, and what cannot be written is compiled at the next start, too, which is told once.
"""

import os
import secrets
from functools import cache
from pathlib import Path
from typing import Any

from numba.core import caching, config

from ogm_services.runtime.log_lines import tell

_writers: dict[int, str] = {}


@cache
def _tell_once(why: str) -> None:
    tell(f"compiled kernels cannot be kept in {why}: they are compiled at every start")


class _KernelFile(caching.IndexDataCacheFile):
    """The compiled versions of one kernel, and the list of them."""

    def save(self, key: Any, data: Any) -> None:  # noqa: ANN401
        try:
            super().save(key, data)  # type: ignore[no-untyped-call]
        except OSError as error:
            _tell_once(f"{config.CACHE_DIR}: {error.strerror or error}")  # type: ignore[attr-defined]

    def _load_index(self) -> Any:  # noqa: ANN401
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except Exception:  # noqa: BLE001 - pickle raises whatever the bytes bring it to
            return {}

    def _load_data(self, name: str) -> Any:  # noqa: ANN401
        try:
            return super()._load_data(name)  # type: ignore[no-untyped-call]
        except Exception as error:
            raise OSError(f"{name}: {error}") from error  # which numba takes for a file that is gone

    def _data_name(self, number: int) -> str:
        writer = _writers.setdefault(os.getpid(), secrets.token_hex(8))  # a fork is another process
        numbered = super()._data_name(number)  # type: ignore[no-untyped-call]
        return f"{numbered.removesuffix('.nbc')}.{writer}.nbc"


# numba has no public place for it; should it keep its files otherwise some day, to load this module fails.
for _method in ("save", "_load_index", "_load_data", "_data_name"):
    getattr(caching.IndexDataCacheFile, _method)
setattr(caching, "IndexDataCacheFile", _KernelFile)  # noqa: B010


class KernelFiles(caching.UserProvidedCacheLocator):
    """Locator (numba: cache locator class) of kernels in NUMBA_CACHE_DIR, and nowhere else.

    By their module's name, wherever it was installed: the folder is one of equal sources already.
    """

    def __init__(self, function: Any, source: str) -> None:  # noqa: ANN401
        """Locate the kernel `function`, which stands in the file `source`."""
        super().__init__(function, source)  # type: ignore[no-untyped-call]
        folder = Path(config.CACHE_DIR)  # type: ignore[attr-defined]
        self._cache_path = str(folder / function.__module__)
