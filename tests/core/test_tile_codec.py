"""Tiles as checked bytes: what comes back, what a record is made of, and that damage is seen."""

import random
import struct
import zlib
from hashlib import blake2b

import numpy as np
import pytest

from mutations import mutated
from ogm_core.cells.model import Plane
from ogm_core.errors import BadStore
from ogm_core.tiles.codec import decode_tile, encode_tile

RNG = np.random.default_rng(3)


def plane(dtype, distinct, side=1):
    """A plane of a tile with so many different numbers, cells beside each other often alike."""
    count = (64 * side) ** 2
    numbers = RNG.integers(0, 256, (distinct, np.dtype(dtype).itemsize), np.uint8).view(dtype)[:, 0]
    return np.repeat(numbers[RNG.integers(0, distinct, count // 4)], 4)


def odd_floats():
    cells = np.zeros(64 * 64)
    cells[:6] = -0.0, np.nan, np.inf, -np.inf, 5e-324, 1e308
    cells[6:7].view(np.uint64)[0] = 0x7FF8_0000_DEAD_BEEF  # a NaN of its own
    return cells


def same_bits(a, b):
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()


PLANES = {
    "unknown": {"l": np.zeros(64 * 64, np.int16)},
    "int16, few numbers": {"l": plane(np.int16, 60)},
    "int16, 256 numbers": {"l": np.arange(64 * 64, dtype=np.int16) % 256 * 100 - 12_000},
    "int16, 257 numbers": {"l": np.arange(64 * 64, dtype=np.int16) % 257 * 100 - 12_000},
    "int16, every number another": {"l": RNG.permutation(2**16)[: 64 * 64].astype(np.uint16).view(np.int16)},
    "float64, few numbers": {"l": plane(np.float64, 200)},
    "float64, odd numbers": {"l": odd_floats()},
    "float64, every number another": {"l": RNG.normal(size=64 * 64)},
    "bytes": {"l": plane(np.uint8, 9)},
    "two planes": {"passed": plane(np.uint16, 30), "ended": plane(np.uint32, 30, side=2)},
}
EVERY = pytest.mark.parametrize("planes", PLANES.values(), ids=PLANES.keys())


def kinds_of(planes):
    return tuple(Plane(name, cells.dtype, {4096: 1, 16384: 2}[len(cells)]) for name, cells in planes.items())


@EVERY
def test_what_is_encoded_comes_back_bit_for_bit(planes):
    decoded = decode_tile(encode_tile(planes), kinds_of(planes))
    assert list(decoded) == list(planes)
    for name, cells in planes.items():
        assert same_bits(decoded[name], cells)


@EVERY
def test_a_record_is_what_its_description_says(planes):
    """A reader of its own, written by the words of codec.py."""
    record = encode_tile(planes)
    for cells in planes.values():
        form, colours, size, checksum = struct.unpack("<BHI16s", record[:23])
        packed, record = zlib.decompress(record[23 : 23 + size]), record[23 + size :]
        numbers = cells.tobytes()  # of this machine, which is little-endian
        assert checksum == blake2b(numbers, digest_size=16).digest()
        different = len(set(struct.iter_unpack(f"{cells.itemsize}s", numbers)))
        if form == 0:
            assert colours == 0
            assert different > 256 or cells.itemsize == 1
            assert packed == numbers
        else:
            assert form == 1
            assert colours == different
            palette = [
                packed[k : k + cells.itemsize] for k in range(0, colours * cells.itemsize, cells.itemsize)
            ]
            assert b"".join(palette[k] for k in packed[colours * cells.itemsize :]) == numbers
    assert record == b""


def test_a_tile_of_few_numbers_is_small():
    """Sixteen grey areas of a float64 map: half a byte a cell, where the cells take eight."""
    assert len(encode_tile({"l": plane(np.float64, 16)})) < 64 * 64 // 2


@EVERY
def test_damage_is_seen(planes):
    """Whatever becomes of a record: it is refused in one line, or it says the same as before."""
    record, kinds, rng = encode_tile(planes), kinds_of(planes), random.Random(5)
    refused = unharmed = 0
    for _ in range(400):
        damaged = mutated(rng, record)
        try:
            decoded = decode_tile(damaged, kinds)
        except BadStore as error:
            refused += 5 < len(str(error)) < 200
        else:
            assert all(same_bits(decoded[name], cells) for name, cells in planes.items())
            unharmed += 1
    assert refused + unharmed == 400
    assert unharmed < 100


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda record: record[:10], "ends too early"),
        (lambda record: record + b"\0", "1 bytes too many"),
        (lambda record: b"\x07" + record[1:], "form 7 with 1 numbers is unknown"),
        (lambda record: b"\x01\x00\x00" + record[3:], "form 1 with 0 numbers is unknown"),
        (lambda record: record[:7] + bytes(16) + record[23:], "its checksum is another"),
        (lambda record: record[:-1] + bytes([record[-1] ^ 1]), "Incorrect checksum"),
    ],
)
def test_damage_is_named(change, said):
    record = encode_tile(PLANES["unknown"])
    with pytest.raises(BadStore, match=f"{said}"):
        decode_tile(change(record), kinds_of(PLANES["unknown"]))


def test_a_record_of_other_planes_is_refused():
    record = encode_tile(PLANES["int16, few numbers"])
    for dtype, side in ((np.float64, 1), (np.int16, 2), (np.uint8, 1)):
        with pytest.raises(BadStore):
            decode_tile(record, (Plane("l", np.dtype(dtype), side),))
    with pytest.raises(BadStore, match="ends too early"):
        decode_tile(record, (Plane("l", np.dtype(np.int16)), Plane("m", np.dtype(np.int16))))


def test_no_record_makes_more_than_a_tile():
    """A bomb: 100 MB in some hundred KB."""
    bomb = zlib.compress(bytes(100_000_000))
    record = struct.pack("<BHI16s", 0, 0, len(bomb), bytes(16)) + bomb
    with pytest.raises(BadStore, match="not as long as a tile"):
        decode_tile(record, kinds_of(PLANES["unknown"]))
