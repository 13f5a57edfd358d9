"""What keeps a command from writing a file, told in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ogm_core.errors import BadInput, DiskFull
from ogm_core.whole_files import NO_ROOM


@contextmanager
def written(path: Path, flag: str) -> Iterator[None]:
    """Around whatever writes `path`, which was given by `flag`: tell what keeps from it.

    Raises:
        BadInput: it cannot be written; the text names the flag, the path and the reason.
        DiskFull: there is no room for it; likewise.
        BrokenPipeError: whoever reads it has had enough.
    """
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        kind = DiskFull if error.errno in NO_ROOM else BadInput
        raise kind(f"{flag} {path}: cannot be written: {error.strerror or error}") from error
