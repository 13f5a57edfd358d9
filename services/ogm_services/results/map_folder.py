"""Folder of a finished map: the files that it is written as."""

import errno
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

from ogm_core.files.map_files import encode_npz, encode_pgm, encode_png, encode_yaml
from ogm_core.snapshot import MapSnapshot
from ogm_core.whole_files import check_file, write_files
from ogm_services.results.written import written

QUALITY = "quality.json"
LOGS = "logs.json"
NAMES = ("map.npz", "map.png", "map.pgm", "map.yaml", QUALITY)
"""What is written of a map, in the order in which the files take their names."""


def check_folder(out: Path) -> None:
    """Make the folder `out` if need be, long before the files of a map are written into it.

    Raises:
        BadInput: it cannot be made or written, or something else has the name of one of the files.
    """
    with written(out, "--out"):
        out.mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        with written(out / name, "--out"):
            check_file(out / name)


def check_place(out: Path) -> None:
    """Find out whether the folder `out` can be made and written, and leave everything as it is.

    Raises:
        BadInput: it cannot.
    """
    with written(out, "--out"):
        nearest = next(path for path in (out, *out.absolute().parents) if os.path.lexists(path))
        if not nearest.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(nearest))
        tempfile.TemporaryFile(dir=nearest).close()
    if out.is_dir():
        check_folder(out)


def write_map(
    out: Path, snapshot: MapSnapshot, quality: dict[str, Any] | None, logs: dict[str, Any] | None = None
) -> None:
    """Write map.npz, map.png, map.pgm, map.yaml and quality.json into the folder `out`, made if need be.

    `logs` says what became of each of several logs: it is logs.json, which is not there otherwise.

    Those for ROS have the snapshot's own cells, the others the finest that its model has.

    Everything is encoded before anything is written, and on disk before the first file takes its name. Where
    `quality` is still to come, by `write_quality`, there is no quality.json afterwards: an old one would be
    another map's.

    Raises:
        MapEmpty: there is nothing to draw.
        BadInput: the folder cannot be written.
    """
    pgm, finest = encode_pgm(snapshot), snapshot.finest()
    files = {
        "map.npz": encode_npz(finest),
        "map.png": encode_png(finest),
        "map.pgm": pgm,
        "map.yaml": encode_yaml(snapshot, "map.pgm", pgm),
    }
    if quality is not None:
        files[QUALITY] = _readable(quality).encode()
    if logs is not None:
        files[LOGS] = _readable(logs).encode()
    with written(out, "--out"):
        out.mkdir(parents=True, exist_ok=True)
        stale = [out / name for name in (QUALITY, LOGS) if name not in files]
        write_files({out / name: content for name, content in files.items()}, without=stale)


def write_quality(out: Path, quality: dict[str, Any]) -> None:
    """Write quality.json beside a map that was written without.

    Raises:
        BadInput: the folder cannot be written.
    """
    content = _readable(quality).encode()
    with written(out, "--out"):
        write_files({out / QUALITY: content})


def _readable(value: dict[str, Any]) -> str:
    """JSON with a line for each name, and each list of numbers on one line."""
    text = json.dumps(value, indent=2)
    return re.sub(r"\[[^][{}\"]*\]", lambda numbers: " ".join(numbers[0].split()), text) + "\n"
