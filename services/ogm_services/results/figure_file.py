"""The file that a figure goes to: whether it can, found out before the work, and what writes it."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ogm_core.errors import BadInput

FORMATS = ("png", "pdf", "svg")


def check_figure(path: Path, out: Path) -> None:
    """Refuse a figure that could not be drawn and written; `out` is the folder that the map will go to.

    Raises:
        BadInput: the format is none of ours, matplotlib is missing, or the file cannot be written.
    """
    if format_of(path) not in FORMATS:
        names = ", ".join(f".{name}" for name in FORMATS)
        raise BadInput(f"--figure {path}: a name that ends in one of {names} is needed")
    inside = path.parent.resolve() == out.resolve()
    if inside and path.name == "map.png":
        raise BadInput(f"--figure {path}: the map's own picture has that name: give another one")
    try:
        import matplotlib.figure  # noqa: F401 (an extra that may be missing)
    except ImportError as error:
        raise BadInput("--figure needs matplotlib: install zenoh-ogm[plot]") from error
    except ValueError as error:
        raise BadInput(f"--figure: matplotlib does not accept its own settings: {error}") from error
    with _written(path):
        if path.exists():
            os.close(os.open(path, os.O_WRONLY | os.O_NONBLOCK))
        elif path.parent.exists() or not inside:
            tempfile.TemporaryFile(dir=path.parent).close()


def write_figure(path: Path, content: bytes) -> None:
    """Write the file.

    Raises:
        BadInput: it cannot be written.
    """
    with _written(path):
        path.write_bytes(content)


def format_of(path: Path) -> str:
    """Format that a file's name says."""
    return path.suffix[1:].lower()


@contextmanager
def _written(path: Path) -> Iterator[None]:
    """Tell what keeps from writing the file what tries to inside."""
    try:
        yield
    except OSError as error:
        raise BadInput(f"--figure {path}: cannot be written: {error.strerror}") from error
