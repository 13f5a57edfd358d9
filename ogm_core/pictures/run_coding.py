"""Kernels that turn tiles of int16 cells into deflate's bits, and these into rows of a picture.

Why not a library's deflate, as for all other pictures (png): a live map's picture is asked for after
every scan, and must cost no more than the tiles that the scan has changed. Libraries code bytes from first to
last; none keeps the bits of a part, nor puts kept bits together at places that are no whole bytes.

A tile's row of 64 cells becomes greys, and these become runs of equal greys. Its first and its last run are
kept as they are, because they may go on in the neighbouring tiles; the runs between them are put into bits
once and for all. A row of the picture is then the tiles' rows one after the other: runs that meet are joined,
bits are copied. For the codes see deflate.

Bits are gathered in a word of 64, `acc`, of which the low `held` are taken; when 32 are, they go out.
Unsigned addresses spare numba's check for negative indices. Words are little-endian, as on every processor
that numba knows.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic, overload
from numpy.typing import NDArray

from ogm_core.pictures.deflate import LONGEST_RUN, SIZE_SHIFT
from ogm_core.tiles.store import TILE

MOST_WORDS = TILE * 32
"""The bits of a tile take at most so many words of 32 bits: 15 bits a cell, and every row begins a word."""
_SIZE = np.uint64(SIZE_SHIFT)
_BITS = np.uint64((1 << SIZE_SHIFT) - 1)
_LOW_WORD = np.uint64(0xFFFFFFFF)
_WORD = np.uint64(32)
_WORD_LESS_ONE = np.uint64(31)
_NONE, _ONE, _FIVE, _SEVEN, _EIGHT = (np.uint64(value) for value in (0, 1, 5, 7, 8))
_TOP_BYTE = np.uint64(56)
_LOW_BYTE = np.uint64(0xFF)
_LOW_SEVEN = np.uint64(0x7F7F7F7F7F7F7F7F)
_HIGH_ONE = np.uint64(0x8080808080808080)
_PAIRS = np.uint64(0x0003000300030003)
_FOURS = np.uint64(0x0000000F0000000F)


def trailing_zeros(word: Any) -> Any:  # noqa: ANN401
    """How many of the lowest bits of a uint64 other than 0 are 0."""
    return np.uint64((int(word) & -int(word)).bit_length() - 1)


@intrinsic
def _cttz(_: Any, word: Any) -> Any:  # noqa: ANN401 - numba types
    def generate(_: Any, builder: Any, __: Any, arguments: Any) -> Any:  # noqa: ANN401
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.uint64(types.uint64), generate


@overload(trailing_zeros)
def _trailing_zeros(word: Any) -> Any:  # noqa: ANN401
    def count(word: Any) -> Any:  # noqa: ANN401
        return _cttz(word)  # type: ignore[call-arg] # numba adds the typing context

    return count


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def changes(words: NDArray[np.uint64]) -> np.uint64:
    """Which of the 64 bytes of 8 words differ from the byte before: bit c for byte c, never bit 0."""
    found = _NONE
    before = words[0] << _TOP_BYTE
    for w in range(8):
        word = words[w]
        differs = word ^ (word << _EIGHT | before >> _TOP_BYTE)
        before = word
        if differs != _NONE:
            # The highest bit of each byte that is not 0, and then these eight bits side by side.
            marked = ((((differs & _LOW_SEVEN) + _LOW_SEVEN) | differs) & _HIGH_ONE) >> _SEVEN
            pairs = (marked | marked >> _SEVEN) & _PAIRS
            fours = (pairs | pairs >> np.uint64(14)) & _FOURS
            found |= ((fours | fours >> np.uint64(28)) & _LOW_BYTE) << np.uint64(8 * w)
    return found


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def draw_row(
    tiles: NDArray[np.int16],
    tile: np.uint64,
    first: np.uint64,
    greys: NDArray[np.uint8],
    steps: NDArray[np.int16],
    row: NDArray[np.uint8],
) -> None:
    """Greys of 64 cells of a tile from cell `first` on.

    They are looked up; or if there are few, from each of `steps` on another one, the differences are added
    up: that way a processor does many cells at once.
    """
    if len(steps) == 0:
        for c in range(np.uint64(TILE)):
            row[c] = greys[np.uint16(tiles[tile, first + c])]
        return
    grey = int(greys[np.uint16(steps[0])])
    row[:] = grey
    for k in range(1, len(steps)):
        step = steps[k]
        rise = int(greys[np.uint16(step)]) - grey
        grey += rise
        for c in range(np.uint64(TILE)):
            row[c] = (int(row[c]) + rise * int(tiles[tile, first + c] >= step)) & 0xFF


@njit(cache=True, nogil=True, error_model="numpy")
def count_runs(tiles: NDArray[np.int16], greys: NDArray[np.uint8]) -> NDArray[np.int64]:
    """How often runs occur in `tiles`, shape (n, 4096), drawn in `greys`.

    By grey and length, shape (256, 260). Rows of one grey are counted as parts of the longest runs.
    """
    counts = np.zeros((256, LONGEST_RUN + 1), np.int64)
    words = np.empty(8, np.uint64)
    row = words.view(np.uint8)
    for t in range(tiles.shape[0]):
        for r in range(TILE):
            for c in range(TILE):
                row[c] = greys[np.uint16(tiles[t, TILE * r + c])]
            left = changes(words)
            begin = 0
            while left != _NONE:
                end = int(np.int64(trailing_zeros(left)))
                counts[row[begin], end - begin] += 1
                begin = end
                left &= left - _ONE
            counts[row[begin], TILE - begin] += 1
    for grey in range(256):
        counts[grey, LONGEST_RUN] = (counts[grey, TILE] * TILE + LONGEST_RUN - 1) // LONGEST_RUN
        counts[grey, TILE] = 0
    return counts


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def put(
    code: np.uint64, acc: np.uint64, held: np.uint64, out: NDArray[np.uint32], used: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64]:
    """Put a code behind the `held` bits of `acc` and the `used` words of `out`."""
    bits, size = code & _BITS, code >> _SIZE
    if size > _WORD:
        out[used] = np.uint32((acc | bits << held) & _LOW_WORD)
        used += _ONE
        acc = (acc | (bits & _LOW_WORD) << held) >> _WORD
        bits >>= _WORD
        size -= _WORD
    acc |= bits << held
    held += size
    out[used] = np.uint32(acc & _LOW_WORD)
    return acc >> (held & _WORD), held & _WORD_LESS_ONE, used + (held >> _FIVE)


@njit(cache=True, nogil=True, error_model="numpy")
def code_tiles(
    tiles: NDArray[np.int16],
    rows: NDArray[np.uint64],
    slots: NDArray[np.uint64],
    greys: NDArray[np.uint8],
    steps: NDArray[np.int16],
    codes: NDArray[np.uint64],
    pool: NDArray[np.uint32],
    used: int,
    outer: NDArray[np.uint8],
    inner: NDArray[np.uint32],
    sums: NDArray[np.int64],
) -> tuple[int, int]:
    """Put `tiles[rows]` into bits behind the first `used` words of `pool`, and describe them under `slots`.

    `outer[slot, row]` is the first run's grey and length and the last run's; a row of one grey has a last run
    of length 0. `inner[slot, row]` tells the bits between them: the word of the pool that they begin with,
    and their number. `sums[slot]` are the sums over the tile of the greys, of grey * column and of grey *
    row. Returns how many tiles were done before the pool was full, and how many of its words are used then.
    """
    words = np.empty(8, np.uint64)
    row = words.view(np.uint8)
    below, weighted = np.empty(TILE, np.uint32), np.empty(TILE, np.uint32)
    out = np.uint64(used)
    for t in range(len(rows)):
        if int(np.int64(out)) + MOST_WORDS > len(pool):
            return t, int(np.int64(out))
        tile, slot = rows[t], slots[t]
        below[:], weighted[:] = 0, 0
        for r in range(np.uint64(TILE)):
            draw_row(tiles, tile, np.uint64(TILE) * r, greys, steps, row)
            for c in range(np.uint64(TILE)):
                below[c] += row[c]
                weighted[c] += below[c]
            left = changes(words)
            first_word = out
            acc = held = begin = _NONE
            if left == _NONE:
                outer[slot, r, 1], outer[slot, r, 3] = TILE, 0
            else:
                begin = trailing_zeros(left)
                left &= left - _ONE
                outer[slot, r, 1] = begin
                while left != _NONE:
                    end = trailing_zeros(left)
                    left &= left - _ONE
                    acc, held, out = put(codes[row[begin], end - begin], acc, held, pool, out)
                    begin = end
                outer[slot, r, 3] = np.uint64(TILE) - begin
            inner[slot, r, 0], inner[slot, r, 1] = first_word, (out - first_word) * _WORD + held
            pool[out] = np.uint32(acc & _LOW_WORD)
            out += (held + _WORD_LESS_ONE) >> _FIVE
            outer[slot, r, 0], outer[slot, r, 2] = row[0], row[TILE - 1]
        total = by_column = from_top = 0
        for c in range(TILE):
            total += int(np.int64(below[c]))
            by_column += c * int(np.int64(below[c]))
            from_top += int(np.int64(weighted[c]))
        # A row's greys are in `weighted` once for it and for every row above.
        sums[slot, 0], sums[slot, 1], sums[slot, 2] = total, by_column, TILE * total - from_top
    return len(rows), int(np.int64(out))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def put_run(
    grey: np.uint8,
    length: int,
    codes: NDArray[np.uint64],
    acc: np.uint64,
    held: np.uint64,
    out: NDArray[np.uint32],
    used: np.uint64,
) -> tuple[np.uint64, np.uint64, np.uint64]:
    """Put `length` bytes `grey`, as runs that are as long as can be."""
    while length > 0:
        part = min(length, LONGEST_RUN)
        acc, held, used = put(codes[grey, np.uint64(part)], acc, held, out, used)
        length -= part
    return acc, held, used


@njit(cache=True, nogil=True, error_model="numpy")
def join_rows(
    slots: NDArray[np.uint64],
    south: int,
    north: int,
    west_cut: int,
    east_cut: int,
    pool: NDArray[np.uint32],
    outer: NDArray[np.uint8],
    inner: NDArray[np.uint32],
    codes: NDArray[np.uint64],
    header: NDArray[np.uint64],
    end: np.uint64,
    out: NDArray[np.uint32],
) -> int:
    """A deflate block of the tiles' rows `north` - 1 down to `south`, each behind its filter byte 0.

    `slots` are those of the tiles from west to east; the first tile's first `west_cut` cells and the last
    one's last `east_cut`, which are unknown, are left out. Returns the bytes of `out` that the block fills,
    with the three bits of an empty stored block that follows it.
    """
    acc = held = used = _NONE
    for k in range(len(header)):
        acc, held, used = put(header[k], acc, held, out, used)
    last = len(slots) - 1
    grey, length = np.uint8(0), 0
    for row in range(north - 1, south - 1, -1):
        r = np.uint64(row)
        if grey != 0:
            acc, held, used = put_run(grey, length, codes, acc, held, out, used)
            grey, length = np.uint8(0), 0
        length += 1
        for t in range(last + 1):
            slot = slots[np.uint64(t)]
            first, final = int(np.int64(outer[slot, r, 1])), int(np.int64(outer[slot, r, 3]))
            flat = final == 0
            if t == 0:
                first -= west_cut
            if t == last:
                if flat:
                    first -= east_cut
                else:
                    final -= east_cut
            if first > 0 and outer[slot, r, 0] != grey:
                acc, held, used = put_run(grey, length, codes, acc, held, out, used)
                grey, length = outer[slot, r, 0], 0
            length += first
            if flat:
                continue
            acc, held, used = put_run(grey, length, codes, acc, held, out, used)
            word, bits = np.uint64(inner[slot, r, 0]), np.uint64(inner[slot, r, 1])
            while bits > _NONE:
                size = min(bits, _WORD)
                acc |= np.uint64(pool[word]) << held
                held += size
                word += _ONE
                bits -= size
                out[used] = np.uint32(acc & _LOW_WORD)
                used += held >> _FIVE
                acc >>= held & _WORD
                held &= _WORD_LESS_ONE
            grey, length = outer[slot, r, 2], final
    acc, held, used = put_run(grey, length, codes, acc, held, out, used)
    acc, held, used = put(end, acc, held, out, used)
    out[used] = np.uint32(acc & _LOW_WORD)
    out[used + _ONE] = 0
    return 4 * int(np.int64(used)) + (int(np.int64(held)) + 3 + 7) // 8
