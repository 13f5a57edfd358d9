"""Output file of a figure: whether it can, found out before the work, and what writes it."""

from pathlib import Path

from ogm_core.errors import BadInput
from ogm_core.whole_files import check_file, write_files
from ogm_services.results.written import written

FORMATS = ("png", "pdf", "svg")


def check_figure(path: Path, out: Path | None = None) -> None:
    """Refuse a figure that could not be drawn and written; `out` is the folder that a map will go to, if any.

    Raises:
        BadInput: the format is none of ours, matplotlib is missing, or the file cannot be written.
    """
    if format_of(path) not in FORMATS:
        names = ", ".join(f".{name}" for name in FORMATS)
        raise BadInput(f"--figure {path}: a name that ends in one of {names} is needed")
    inside = out is not None and path.parent.resolve() == out.resolve()
    if inside and path.name == "map.png":
        raise BadInput(f"--figure {path}: the map's own picture has that name: give another one")
    try:
        import matplotlib.figure  # noqa: F401 (an extra that may be missing)
    except ImportError as error:
        raise BadInput("--figure needs matplotlib: install zenoh-ogm[plot]") from error
    except ValueError as error:
        raise BadInput(f"--figure: matplotlib does not accept its own settings: {error}") from error
    with written(path, "--figure"):
        if path.parent.exists() or not inside:
            check_file(path)


def write_figure(path: Path, content: bytes) -> None:
    """Write the file.

    Raises:
        BadInput: it cannot be written.
    """
    with written(path, "--figure"):
        write_files({path: content})


def format_of(path: Path) -> str:
    """Format that a file's name says."""
    return path.suffix[1:].lower()
