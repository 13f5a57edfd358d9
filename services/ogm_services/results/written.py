"""Files that commands write: where to, and what keeps from it, told in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from ogm_core.errors import BadInput, DiskFull
from ogm_core.whole_files import NO_ROOM


def out_path(text: str) -> Path:
    """The path that a flag says to write to.

    Raises:
        BadParameter: it is empty, as of a variable that is not set: `Path` takes that for the working folder.
    """
    if not text:
        raise typer.BadParameter("a path is needed, got ''")
    return Path(text)


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
