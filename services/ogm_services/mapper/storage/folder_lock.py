"""Lock of a store's folder: one process at a time, however the last one ended."""

import contextlib
import fcntl
import os
from pathlib import Path
from typing import Self

from ogm_core.errors import BadInput, OgmError

FILE = "lock"


class StoreInUse(OgmError):
    """Another process has the folder."""

    slug = "store-in-use"


class FolderLock:
    """A lock that the system lets go of when its process ends."""

    def __init__(self, folder: Path) -> None:
        """Make the folder if need be, and lock it.

        Raises:
            StoreInUse: another process has it; the text says which.
            BadInput: there can be no such folder.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._file = os.open(folder / FILE, os.O_RDWR | os.O_CREAT, 0o644)
        except OSError as error:
            raise BadInput(f"{folder}: a map cannot be stored there: {error.strerror or error}") from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            owner = os.read(self._file, 20).decode("ascii", "replace").strip()
            self.release()
            whose = f"process {owner}" if owner.isdigit() else "another process"
            raise StoreInUse(
                f"{folder}: {whose} stores its map there: give every mapper a folder of its own"
            ) from error
        with contextlib.suppress(OSError):  # a full disk: nobody learns who it was
            os.truncate(self._file, 0)
            os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def release(self) -> None:
        """Let others have the folder."""
        os.close(self._file)
