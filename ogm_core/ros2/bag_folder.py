"""Folders of rosbag2: which of their files hold the messages, by metadata.yaml or without it."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import yaml

from ogm_core.errors import BadRecording, cut, printable
from ogm_core.units import MEBIBYTE

METADATA = "metadata.yaml"
DATA_SUFFIXES = (".db3", ".mcap")
MAX_METADATA = 16 * MEBIBYTE
"""A longer metadata.yaml is none."""
_PACKED = ".zstd"
"""What rosbag2 adds to the name of a data file that it compressed as a whole."""
_SHOWN = 12
"""Names that are listed at most."""
_ERRORS = (*(yaml.YAMLError, OSError, ValueError, TypeError, LookupError), AttributeError, RecursionError)


@dataclass(frozen=True, slots=True)
class BagFolder:
    """The data files of a bag, in their order. `packed`: metadata.yaml says how they are compressed."""

    files: tuple[Path, ...]
    packed: bool = False
    notes: list[str] = field(default_factory=list)


def bag_folder(folder: Path) -> BagFolder:
    """Look into a folder.

    Raises:
        OSError: it cannot be looked into.
        BadRecording: it is that of no bag, or of several.
    """
    found = sorted((each for each in folder.iterdir() if _suffix(each) and each.is_file()), key=_by_number)
    has_metadata = (folder / METADATA).is_file()
    if not found:
        if has_metadata:
            raise BadRecording(f"{folder}: the folder of a bag without its data files (.db3, .mcap)")
        raise BadRecording(f"{folder}: a folder, and no bag: give a log or a bag that is in it")
    notes = [] if has_metadata else [f"there is no {METADATA}: its data files are read alone"]
    if has_metadata:
        try:
            return _as_told(folder, found)
        except _ERRORS as error:
            said = cut(printable(" ".join(str(error).split())))
            notes = [
                f"{METADATA} is of no use, its data files are read alone ({type(error).__name__}: {said})"
            ]
    if any(each.suffix == _PACKED for each in found):
        text = (
            f"{folder}: its data files are compressed, and no {METADATA} says how: unpack them with zstd -d"
        )
        raise BadRecording(text)
    bags = sorted({re.sub(r"_?\d+$", "", each.stem) + each.suffix for each in found})
    if len(bags) > 1:
        raise BadRecording(f"{folder}: holds data files of several bags ({listed(bags)}): give one of them")
    return BagFolder(tuple(found), notes=notes)


def listed(names: Iterable[str]) -> str:
    """Names in a row, the first ones of them."""
    shown = [cut(printable(name)) for name in sorted(names)]
    more = f" and {len(shown) - _SHOWN} more" if len(shown) > _SHOWN else ""
    return ", ".join(shown[:_SHOWN]) + more


def _as_told(folder: Path, found: list[Path]) -> BagFolder:
    """What metadata.yaml says, as far as it is true; raises one of _ERRORS if it cannot be used."""
    told = _loaded(folder / METADATA)["rosbag2_bagfile_information"]
    names = [PurePath(each).name for each in told["relative_file_paths"]]
    by_name = {each.name: each for each in found}
    files = tuple(by_name[name] for name in dict.fromkeys(names) if name in by_name)
    if not files:
        raise ValueError("it names none of them")
    if len({_suffix(each) for each in files}) > 1:
        raise ValueError("it names files of several kinds")
    notes = []
    missing = [name for name in names if name not in by_name]
    if missing:
        notes.append(f"missing, though {METADATA} names them: {listed(missing)}")
    beside = [name for name in by_name if name not in names]
    if beside:
        notes.append(f"not read, as {METADATA} does not name them: {listed(beside)}")
    mode = str(told.get("compression_mode") or "none").lower()
    return BagFolder(files, mode != "none", notes)


def _loaded(path: Path) -> Any:  # noqa: ANN401 - what YAML holds
    if path.stat().st_size > MAX_METADATA:
        raise ValueError(f"it has more than {MAX_METADATA} bytes")
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    return yaml.load(path.read_text("utf-8"), loader)


def _suffix(path: Path) -> str:
    """The kind of a data file, packed or not; "" for other files."""
    suffix = Path(path.stem).suffix if path.suffix == _PACKED else path.suffix
    return suffix if suffix in DATA_SUFFIXES else ""


def _by_number(file: Path) -> tuple[int, str]:
    """Where a data file stands among those of a bag that was split: bag_10 after bag_9."""
    number = re.search(r"(\d+)$", file.stem)
    return (int(number[1]) if number else -1, file.name)
