"""The files that a finished map is written as."""

import json
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ogm_core.errors import BadInput
from ogm_core.files.map_files import encode_npz, encode_pgm, encode_png, encode_yaml
from ogm_core.snapshot import MapSnapshot


def check_folder(out: Path) -> None:
    """Make the folder `out` if need be, long before anything is written into it.

    Raises:
        BadInput: it cannot be made or written.
    """
    with _written(out), tempfile.TemporaryFile(dir=out):
        pass


def write_map(out: Path, snapshot: MapSnapshot, quality: dict[str, Any]) -> None:
    """Write map.png, map.pgm, map.yaml, map.npz and quality.json into the folder `out`, made if need be.

    Everything is encoded before anything is written.

    Raises:
        MapEmpty: there is nothing to draw.
        BadInput: the folder cannot be written.
    """
    files = {
        "map.png": encode_png(snapshot),
        "map.pgm": encode_pgm(snapshot),
        "map.yaml": encode_yaml(snapshot, "map.pgm"),
        "map.npz": encode_npz(snapshot),
        "quality.json": _readable(quality).encode(),
    }
    with _written(out):
        for name, content in files.items():
            (out / name).write_bytes(content)


def _readable(value: dict[str, Any]) -> str:
    """JSON with a line for each name, and each list of numbers on one line."""
    text = json.dumps(value, indent=2)
    return re.sub(r"\[[^][{}\"]*\]", lambda numbers: " ".join(numbers[0].split()), text) + "\n"


@contextmanager
def _written(out: Path) -> Iterator[None]:
    """Make the folder `out` for what writes into it inside, and tell what keeps it from doing so."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        yield
    except OSError as error:
        raise BadInput(f"--out {out}: cannot be written: {error.strerror}") from error
