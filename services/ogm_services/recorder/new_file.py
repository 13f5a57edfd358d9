"""The file of a recording while it is written: a new one, of which nobody else makes anything meanwhile."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from ogm_core.errors import BadInput
from ogm_core.whole_files import check_file
from ogm_services.results.written import written
from ogm_services.ros2.mcap_file import MCAP_SUFFIX

FLAG = "-o"


def check_new(path: Path) -> None:
    """Refuse what cannot become a recording, before anything else is done.

    Raises:
        BadInput: it is there already, its name does not end in .mcap, or it cannot be written.
    """
    if path.suffix.lower() != MCAP_SUFFIX:
        raise BadInput(f"{FLAG} {path}: recordings of robots are MCAP files: end it in {MCAP_SUFFIX}")
    if path.exists() or path.is_symlink():
        raise _is_there(path)
    with written(path, FLAG):
        check_file(path)


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """A new file to write into; it is locked, so that `ogm record --repair` leaves it alone.

    What goes wrong when it closes was told when it was flushed.

    Raises:
        BadInput: it is there already, or cannot be written.
        DiskFull: there is no room for it.
    """
    with written(path, FLAG):
        try:
            file = path.open("xb")
        except FileExistsError as error:
            raise _is_there(path) from error
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield file
    finally:
        with suppress(OSError):
            file.close()


def _is_there(path: Path) -> BadInput:
    return BadInput(f"{FLAG} {path}: is there already: give another name, or remove it")
