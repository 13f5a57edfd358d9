"""Files that are written whole or not at all: what goes wrong on the way leaves what was there before."""

import errno
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import BinaryIO

NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""What an OSError says of a disk that is full, a quota that is used up, a file longer than is allowed."""
_STREAMS = re.compile(r"/dev/(stdout|stderr|fd/.*)|/proc/[^/]+/fd/.*")
"""Names of what a process has open already; it must not be replaced, even if it is a regular file."""


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A file to write into: a temporary one beside `path`, which it replaces once it is complete and on disk.

    A pipe, a device and the like are written directly, and so is what /dev/stdout stands for. A file that is
    replaced keeps its mode, and a symbolic link to it goes on to lead to it.

    Raises:
        OSError: the file cannot be written.
    """
    target = _replaced(path)
    if target is None:
        with path.open("wb") as file:
            yield file
        return
    part = target.with_name(f".ogm-{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            yield file
            _flush(file)
        if target.exists():
            shutil.copymode(target, part)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def write_files(contents: Mapping[Path, bytes], *, without: Iterable[Path] = ()) -> None:
    """Write files that belong together: all of them are on disk before the first, in order, takes its name.

    `without` are those that there are no more afterwards.

    Raises:
        OSError: one of them cannot be written.
    """
    with ExitStack() as renamed_last_to_first:
        for path, content in reversed(list(contents.items())):
            file = renamed_last_to_first.enter_context(whole_file(path))
            file.write(content)
            _flush(file)
        for path in without:
            path.unlink(missing_ok=True)


def check_file(path: Path) -> None:
    """Find out whether `whole_file` can write `path`, and leave it as it is.

    Raises:
        OSError: it cannot.
    """
    target = _replaced(path)
    if target is None:
        if not os.access(path, os.W_OK):  # to open a pipe and close it would tell its reader that this is all
            number = errno.EACCES if path.exists() else errno.ENOENT
            raise OSError(number, os.strerror(number), str(path))
    else:
        tempfile.TemporaryFile(dir=target.parent).close()


def _replaced(path: Path) -> Path | None:
    """The file that is replaced, its links followed; None for what is written directly."""
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if _STREAMS.fullmatch(str(path.absolute())) or (path.exists() and not path.is_file()):
        return None
    try:
        return path.resolve()
    except RuntimeError as error:  # Python 3.11 and 3.12 say so of links that lead in a circle
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path)) from error


def _flush(file: BinaryIO) -> None:
    """See to it that what was written is on disk, where the file lies on one."""
    file.flush()
    try:
        os.fsync(file.fileno())
    except OSError as error:
        if error.errno != errno.EINVAL:  # a pipe or a device
            raise
