"""Map snapshots as files: PNG, PGM with its YAML, JSON, NPZ. Only here are rows turned north up."""

import io
import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ogm_core.cells.classes import percent, probability_grey, ros_grey, trinary
from ogm_core.cells.model import Encoder, Known, Probability
from ogm_core.cells.thresholds import FREE_BELOW, check_free_below
from ogm_core.cells.value_bytes import COLOURS, value_byte
from ogm_core.errors import BadInput, BadMapFile, BadParameter, BadSetting, MapEmpty, cut
from ogm_core.files.npz_arrays import UNREADABLE, NpzArrays
from ogm_core.files.ros_map_writer import Seal, write_pgm, write_yaml
from ogm_core.lattice import MAX_INDEX
from ogm_core.pictures.png import write_png
from ogm_core.snapshot import MapSnapshot

FRAME = "map"
HALF_LIFE = "half_life"
DEFAULT_PALETTE = "ros"
_FREE_BELOW = "free_below"
PALETTES: dict[str, Encoder] = {DEFAULT_PALETTE: ros_grey, "probability": probability_grey}
"""Of grey pictures; those of `cells.value_bytes` have colours, or let through what is unknown."""

_ENTRIES = np.frombuffer(b"".join(b"%3d," % value for value in range(-1, 101)), np.uint32)
"""-1, 0 ... 100 as items of a JSON array, four bytes each (JSON allows the blanks): a map is one look-up."""
MAX_NPZ_BYTES = 1024**3
"""A map whose cells take more is not read, unless more is allowed; 100 million float64 take less."""

_T = TypeVar("_T")


def encode_png(snap: MapSnapshot, palette: str = DEFAULT_PALETTE, *, transparent: bool = False) -> bytes:
    """PNG, north up: 8-bit greys in the palettes "ros" and "probability", else value bytes with colours.

    `transparent`: value bytes in any palette, and what is unknown is not drawn.

    Raises:
        MapEmpty: there is nothing to draw.
        BadParameter: no such palette.
    """
    colours = chosen(COLOURS, "palette", palette)
    check_not_empty(snap)
    if palette in PALETTES and not transparent:
        return write_png(snap.encode(PALETTES[palette])[::-1])
    return write_png(snap.encode(value_byte)[::-1], colours, transparent=transparent)


def encode_pgw(snap: MapSnapshot) -> bytes:
    """World file of the PNG of the same snapshot: six lines that tell a GIS where its pixels lie, m.

    Pixels from west to east, two turns, pixels from south to north, which go down; then the centre of the
    pixel in the upper left corner.

    Raises:
        MapEmpty: there is no picture to place.
    """
    check_not_empty(snap)
    x, y = snap.origin
    pixel = snap.resolution
    lines = (pixel, 0.0, 0.0, -pixel, x + pixel / 2, y + (snap.height - 0.5) * pixel)
    return "".join(f"{line!r}\n" for line in lines).encode()


def encode_pgm(snap: MapSnapshot, palette: str = DEFAULT_PALETTE) -> bytes:
    """Binary PGM, north up; with palette "ros" nav2 map_server reads it by the file of `encode_yaml`.

    Raises:
        MapEmpty: there is nothing to draw.
        BadParameter: no such palette.
    """
    encoder = chosen(PALETTES, "palette", palette)
    check_not_empty(snap)
    return write_pgm(snap.encode(encoder)[::-1])


def encode_yaml(snap: MapSnapshot, image_name: str, pgm: bytes | None = None) -> bytes:
    """nav2 map_server's description of the PGM named `image_name`, UTF-8, with that file's size and CRC-32.

    `pgm` is what `encode_pgm` made of this snapshot, if that is at hand.

    Raises:
        MapEmpty: there is no picture to describe.
    """
    seal = Seal(snap.width, snap.height, zlib.crc32(encode_pgm(snap) if pgm is None else pgm))
    return write_yaml(image_name, snap.resolution, snap.origin, seal, snap.model.free_below).encode()


def encode_json(snap: MapSnapshot, map_name: str, values: str = "percent") -> bytes:
    """JSON object: name, frame, what `MapSnapshot.meta` says, and `data`.

    `data` is row-major from the lower-left cell. With values "percent" it is 0 to 100, or -1 where unknown;
    with "trinary" 0, 100 or -1.

    Raises:
        BadParameter: no such values.
    """
    entries = snap.encode(chosen(VALUES, "values", values))
    head = json.dumps({"map": map_name, "frame": FRAME, **snap.meta()})
    data = entries.reshape(-1).view(np.uint8).data
    return b"".join((head[:-1].encode(), b', "data": [', data[:-1], b"]}"))  # without the last comma


def encode_npz(snap: MapSnapshot) -> bytes:
    """NumPy archive, equal bytes for equal maps: the cells, `resolution`, `origin`, `offset`, `anchor`.

    And `free_below` of a map that has one of its own.

    What is there of the cells, [iy, ix], row 0 south, is the cell model's `arrays`: of log odds, `log_odds`,
    NaN where unknown, float64 of float64 cells, else float32. Of a map that forgets also `half_life`, s.
    """
    forgets = {} if snap.half_life is None else {HALF_LIFE: np.array(float(snap.half_life))}
    return pack(
        {
            **snap.model.arrays(snap.stored),
            **place_arrays(snap),
            **own_free_below(snap.model.free_below),
            **forgets,
        }
    )


def place_arrays(snap: MapSnapshot) -> dict[str, NDArray[Any]]:
    """Where the cells of a snapshot lie, as an archive tells it."""
    return {
        "resolution": np.array(snap.resolution),
        "origin": np.array(snap.origin),
        "offset": np.array(snap.offset, np.int64),
        "anchor": np.array(snap.lattice.anchor),
    }


def own_free_below(value: float) -> dict[str, NDArray[Any]]:
    """What an archive says of a `free_below` that is not the usual one."""
    return {} if value == FREE_BELOW else {_FREE_BELOW: np.array(value)}


def pack(arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """NumPy archive of arrays, equal bytes for equal ones."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            # Opened by name, a member is dated 1980, whatever the clock says.
            with archive.open(f"{name}.npy", "w", force_zip64=array.nbytes >= 2**31) as member:
                npy.write_array(member, array, allow_pickle=False)
    return file.getvalue()


class Place(NamedTuple):
    """Where cells lie: [iy, ix] has its lower-left corner at anchor + (offset + (ix, iy)) * resolution, m."""

    resolution: float
    anchor: tuple[float, float]
    offset: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class NpzMap:
    """What `encode_npz` wrote: log odds [iy, ix], row 0 south, NaN where unknown.

    Cell [iy, ix] has its lower-left corner at anchor + (offset + (ix, iy)) * resolution, m.
    """

    log_odds: NDArray[np.floating[Any]]
    resolution: float
    anchor: tuple[float, float]
    offset: tuple[int, int]
    free_below: float = FREE_BELOW


def read_npz(data: bytes, name: str = "map.npz", *, max_bytes: int = MAX_NPZ_BYTES) -> NpzMap:
    """Read what `encode_npz` wrote; its cells may take `max_bytes`, and nothing is unpacked of more.

    Raises:
        BadInput: it is something else, damaged or too large; the text begins with `name` and says what is
            wrong.
    """
    return _read_npz(io.BytesIO(data), name, max_bytes)


def load_npz(path: Path, *, max_bytes: int = MAX_NPZ_BYTES) -> NpzMap:
    """Read a file that holds what `encode_npz` wrote, likewise.

    Raises:
        BadMapFile: it cannot be read, is something else, damaged or too large; the text says what is wrong.
    """
    try:
        with path.open("rb") as file:
            return _read_npz(file, str(path), max_bytes)
    except OSError as error:
        raise BadMapFile(f"{path}: cannot be read: {error.strerror or error}") from error
    except BadInput as error:
        raise BadMapFile(str(error)) from error


def _read_npz(file: BinaryIO, name: str, max_bytes: int) -> NpzMap:
    try:
        with NpzArrays(file) as arrays:
            packed = arrays["log_odds"]
            if len(packed.shape) != 2 or packed.dtype not in (np.float32, np.float64):
                raise BadInput(f"{name}: log_odds is {packed}, rows of float32 or float64 are needed")
            if packed.nbytes > max_bytes:
                raise BadInput(
                    f"{name}: its cells take {packed.nbytes} bytes, at most {max_bytes} are allowed"
                )
            place, free_below = check_place(arrays, name), read_free_below(arrays, name)
            log_odds = packed.read()
    except UNREADABLE as error:
        raise BadInput(
            f"{name}: not a map that was saved here and can be read ({str(error)[:400]})"
        ) from error
    return NpzMap(log_odds, *place, free_below)


def check_place(arrays: NpzArrays, name: str) -> Place:
    """Where the cells of an archive lie.

    Raises:
        BadInput: that cannot be; the text begins with `name`.
    """
    resolution = _values(arrays, "resolution", (), np.float64)
    anchor = _values(arrays, "anchor", (2,), np.float64)
    offset = _values(arrays, "offset", (2,), np.int64)
    if not 0.0 < resolution < np.inf:
        raise BadInput(f"{name}: resolution is {resolution}, a positive number is needed")
    if not np.isfinite(anchor).all():
        raise BadInput(f"{name}: anchor is {anchor}, finite numbers are needed")
    if not (abs(offset // 2) < MAX_INDEX // 2).all():
        raise BadInput(f"{name}: offset is {offset}, at most {MAX_INDEX} cells are needed")
    x, y = anchor.tolist()
    ix, iy = offset.tolist()
    return Place(float(resolution), (x, y), (ix, iy))


def read_free_below(arrays: NpzArrays, name: str) -> float:
    """Which probabilities mean free in the map of an archive.

    Raises:
        BadInput: that cannot be; the text begins with `name`.
    """
    if _FREE_BELOW not in arrays:
        return FREE_BELOW
    value = float(_values(arrays, _FREE_BELOW, (), np.float64))
    try:
        check_free_below(value)
    except BadSetting as error:
        raise BadInput(f"{name}: {error}") from error
    return value


def _values(arrays: NpzArrays, name: str, shape: tuple[int, ...], dtype: type) -> NDArray[Any]:
    packed = arrays[name]
    if packed.shape != shape or packed.dtype != dtype:
        raise ValueError(f"{name} is {packed}, {np.dtype(dtype)} of shape {shape} is needed")
    return packed.read()


def check_not_empty(snap: MapSnapshot) -> None:
    """Refuse to draw nothing.

    Raises:
        MapEmpty: the map has no cell.
    """
    if snap.empty:
        raise MapEmpty("the map has no known cell yet: try again after the first scan")


def chosen(choices: Mapping[str, _T], what: str, name: str) -> _T:
    """What `name` stands for among the choices for a parameter.

    Raises:
        BadParameter: it is none of them.
    """
    if name not in choices:
        raise BadParameter(f"{what}: one of {', '.join(choices)} is needed, got {cut(name)!r}")
    return choices[name]


def _json_percent(p: Probability, known: Known, _free_below: float) -> NDArray[np.uint32]:
    return _ENTRIES[percent(p, known) + 1]


def _json_trinary(p: Probability, known: Known, free_below: float) -> NDArray[np.uint32]:
    return _ENTRIES[trinary(p, known, free_below) + 1]


VALUES: dict[str, Encoder] = {"percent": _json_percent, "trinary": _json_trinary}
