"""Layers as files, PNG and NPZ: values that were computed of a map's cells, and where these lie."""

import io
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ogm_core.cells.classes import (
    FREE,
    GREY_FREE,
    GREY_OCCUPIED,
    GREY_UNKNOWN,
    OCCUPIED,
)
from ogm_core.errors import BadInput
from ogm_core.files.map_files import MAX_NPZ_BYTES, Place, check_place, pack, place_arrays
from ogm_core.files.npz_arrays import UNREADABLE, NpzArrays
from ogm_core.pictures.png import write_png
from ogm_core.snapshot import MapSnapshot

DISTANCE, OCCUPANCY = "distance", "occupancy"
"""Names of the arrays: metres, float32; and trinary states, int8."""
_DTYPES: dict[str, type] = {DISTANCE: np.float32, OCCUPANCY: np.int8}


def encode_layer_npz(name: str, values: NDArray[Any], snap: MapSnapshot) -> bytes:
    """NumPy archive of a layer, [iy, ix], row 0 south, and of where the cells of its snapshot lie."""
    return pack({name: values, **place_arrays(snap)})


def encode_distance_png(metres: NDArray[np.float32], max_distance: float) -> bytes:
    """8-bit grey PNG, north up: floor(255 d / max_distance + 0.5), 255 from there on."""
    share = np.minimum(metres, np.float32(max_distance)) * np.float32(255.0 / max_distance)
    return write_png(np.floor(share + np.float32(0.5)).astype(np.uint8)[::-1])


def encode_states_png(states: NDArray[np.int8]) -> bytes:
    """8-bit grey PNG, north up, of trinary states: 0 occupied, 254 free, 205 unknown or undecided."""
    grey = np.where(states == OCCUPIED, GREY_OCCUPIED, np.where(states == FREE, GREY_FREE, GREY_UNKNOWN))
    return write_png(grey.astype(np.uint8)[::-1])


class NpzLayer(NamedTuple):
    """What `encode_layer_npz` wrote: its values, [iy, ix], row 0 south, and where they lie."""

    values: NDArray[Any]
    place: Place


def read_layer_npz(data: bytes, name: str, *, max_bytes: int = MAX_NPZ_BYTES) -> NpzLayer:
    """Read what `encode_layer_npz` wrote under a name; its values may take `max_bytes`.

    Raises:
        BadInput: it is something else, damaged or too large; the text begins with the name.
    """
    try:
        with NpzArrays(io.BytesIO(data)) as arrays:
            packed = arrays[name]
            if len(packed.shape) != 2 or packed.dtype != _DTYPES[name]:
                raise BadInput(f"{name}: it is {packed}, rows of {np.dtype(_DTYPES[name])} are needed")
            if packed.nbytes > max_bytes:
                raise BadInput(
                    f"{name}: its values take {packed.nbytes} bytes, at most {max_bytes} are allowed"
                )
            return NpzLayer(packed.read(), check_place(arrays, name))
    except UNREADABLE as error:
        raise BadInput(f"{name}: not a layer that can be read ({str(error)[:400]})") from error
