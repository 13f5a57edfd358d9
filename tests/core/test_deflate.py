"""Deflate's codes, read back by zlib."""

import zlib

import numpy as np
import pytest

from ogm_core.pictures.deflate import LONGEST_RUN, SIZE_SHIFT, code_for

SHAPE = 256, LONGEST_RUN + 1


def stream(code, runs):
    """A raw deflate stream of (byte, length) runs, bit after bit."""
    bits = size = 0
    puts = [*code.header, *(code.runs[run] for run in runs), code.end, (3 << SIZE_SHIFT) | 1, 7 << SIZE_SHIFT]
    for put in map(int, puts):  # at the end an empty block by fixed codes, the last one
        bits |= (put & ((1 << SIZE_SHIFT) - 1)) << size
        size += put >> SIZE_SHIFT
    return bits.to_bytes(size // 8 + 1, "little")


def read(data):
    return zlib.decompressobj(-15).decompress(data)


def every_run(bytes_):
    return [(byte, length) for byte in bytes_ for length in range(1, LONGEST_RUN + 1)]


def expected(runs):
    return b"".join(bytes([byte]) * length for byte, length in runs)


@pytest.mark.parametrize("seed", range(8))
def test_every_run_of_every_byte_is_read_back(seed):
    rng = np.random.default_rng(seed)
    counts = rng.pareto(0.2 + 0.1 * seed, SHAPE).clip(0, 1e9).astype(np.int64)
    counts[:, 1] += 1
    runs = every_run(range(256))
    assert read(stream(code_for(counts), runs)) == expected(runs)


def test_bytes_that_do_not_occur_take_no_room():
    counts = np.zeros(SHAPE, np.int64)
    counts[[0, 205, 254], 1] = 1
    code = code_for(counts)
    runs = every_run([205, 0, 254])
    assert read(stream(code, runs)) == expected(runs)
    assert not code.runs[7].any() or int(code.runs[7, 1]) >> SIZE_SHIFT == 0


def test_no_code_is_longer_than_deflate_allows():
    counts = np.zeros(SHAPE, np.int64)
    counts[:40, 1] = [int(1.7**k) for k in range(40)]  # an unbounded code would be 39 bits deep
    code = code_for(counts)
    sizes = [int(code.runs[byte, 1]) >> SIZE_SHIFT for byte in range(40)]
    assert max(sizes) == 15
    assert sizes == sorted(sizes, reverse=True)
    runs = every_run(range(40))
    assert read(stream(code, runs)) == expected(runs)


def test_frequent_runs_are_short():
    counts = np.zeros(SHAPE, np.int64)
    counts[9, 1], counts[8, 1], counts[7, 64] = 1000, 10, 500
    code = code_for(counts)
    size = {key: int(code.runs[key]) >> SIZE_SHIFT for key in [(9, 1), (8, 1), (7, 64), (9, 64)]}
    assert size[9, 1] < size[8, 1]
    assert size[9, 64] < size[7, 64] + size[8, 1]
