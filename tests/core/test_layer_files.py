"""Layers as files: what is written is read again, greys are those of the formula, damage is told."""

import io

import numpy as np
import pytest
from PIL import Image

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.classes import FREE, OCCUPIED, UNKNOWN
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadInput
from ogm_core.files.layer_files import (
    DISTANCE,
    OCCUPANCY,
    encode_distance_png,
    encode_layer_npz,
    encode_states_png,
    read_layer_npz,
)
from ogm_core.files.map_files import encode_npz
from ogm_core.lattice import Lattice
from ogm_core.snapshot import MapSnapshot

MODEL = LogOdds()
METRES = np.array([[0.0, 0.5, np.inf], [1.0, 2.0, 7.5]], np.float32)
STATES = np.array([[FREE, OCCUPIED, UNKNOWN]], np.int8)


def snapshot(shape):
    cells = CellArrays.of(MODEL, np.zeros(shape, np.int16))
    return MapSnapshot(cells, MODEL, Lattice(0.05, (0.1, -7.3)), (-3, 12), "e", 7, None)


def drawn(png):
    with Image.open(io.BytesIO(png)) as image:
        assert image.mode == "L"
        return np.asarray(image).tolist()


@pytest.mark.parametrize(("name", "values"), [(DISTANCE, METRES), (OCCUPANCY, STATES)])
def test_a_layer_is_read_as_it_was_written(name, values):
    shown = snapshot(values.shape)
    data = encode_layer_npz(name, values, shown)
    read = read_layer_npz(data, name)
    assert np.array_equal(read.values, values)
    assert read.values.dtype == values.dtype
    assert read.place == (0.05, (0.1, -7.3), (-3, 12))
    assert encode_layer_npz(name, values, shown) == data
    assert read_layer_npz(data, name, max_bytes=values.nbytes).place == read.place
    with pytest.raises(BadInput, match=rf"^{name}: its values take {values.nbytes} bytes, at most"):
        read_layer_npz(data, name, max_bytes=values.nbytes - 1)
    with pytest.raises(BadInput, match=r"^occupancy: not a layer that can be read|^distance: not a layer"):
        read_layer_npz(data, OCCUPANCY if name == DISTANCE else DISTANCE)
    empty = encode_layer_npz(name, values[:0, :0], snapshot((0, 0)))
    assert read_layer_npz(empty, name).values.shape == (0, 0)


def test_what_is_no_layer_is_told():
    shown = snapshot((2, 3))
    for data in (b"", b"garbage", encode_npz(shown)):
        with pytest.raises(BadInput, match=r"^distance: not a layer that can be read"):
            read_layer_npz(data, DISTANCE)
    with pytest.raises(BadInput, match=r"^distance: it is float64 of shape .*, rows of float32 are needed"):
        read_layer_npz(encode_layer_npz(DISTANCE, METRES.astype(np.float64), shown), DISTANCE)
    with pytest.raises(BadInput, match=r"^distance: it is float32 of shape .*, rows of float32 are needed"):
        read_layer_npz(encode_layer_npz(DISTANCE, METRES[0], shown), DISTANCE)


def test_damage_is_told_or_harmless():
    rng = np.random.default_rng(1)
    good = encode_layer_npz(DISTANCE, METRES, snapshot(METRES.shape))
    told = []
    for _ in range(400):
        data = bytearray(good)
        for place in rng.integers(0, len(data), rng.integers(1, 4)):
            data[place] ^= 1 << rng.integers(0, 8)
        try:
            read = read_layer_npz(
                bytes(data[: rng.integers(1, len(data) + 1)] if rng.random() < 0.2 else data), DISTANCE
            )
        except BadInput as error:
            told.append(str(error))
        else:
            assert read.values.ndim == 2
    assert len(told) > 200
    assert all(text.startswith("distance: ") for text in told)


def test_distances_are_greys_up_to_the_largest():
    assert drawn(encode_distance_png(METRES, 2.55)) == [[100, 200, 255], [0, 50, 255]]
    assert drawn(encode_distance_png(METRES, 10.0)) == [[26, 51, 191], [0, 13, 255]]


def test_states_are_the_greys_of_a_map():
    assert drawn(encode_states_png(STATES)) == [[254, 0, 205]]
    assert drawn(encode_states_png(STATES.T.copy())) == [[205], [0], [254]]
