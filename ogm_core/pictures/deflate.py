"""Deflate's prefix codes for pictures that are described by runs of equal bytes.

A run is a literal and repeats of it: matches at distance 1. One code serves a whole picture, so that pieces
which were coded at different times can be put together, bit after bit.

Sources: P. Deutsch, RFC 1951, DEFLATE Compressed Data Format Specification version 1.3, sections 3.2.2 (codes
from lengths), 3.2.5 (literals, lengths, distances) and 3.2.7 (blocks with codes of their own); D. A. Huffman,
A Method for the Construction of Minimum-Redundancy Codes, Proc. IRE, 1952.
"""

import heapq
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

LONGEST_RUN = 259
"""A literal and 258 repeats."""
SIZE_SHIFT = 58
"""A code is kept in 64 bits: its bits, the first one lowest, and from here on how many they are."""
END_OF_BLOCK = 256
_SYMBOLS = 286
_LONGEST_CODE = 15
_SHORTEST_MATCH = 3


@dataclass(frozen=True, slots=True, eq=False)
class RunCode:
    """The codes of one picture; see SIZE_SHIFT."""

    runs: NDArray[np.uint64]
    """Of a run by byte and length, shape (256, 260); lengths of 1 to 259 are used."""
    header: NDArray[np.uint64]
    """What a block begins with, to be put in order."""
    end: np.uint64
    """What it ends with."""


def code_for(counts: NDArray[np.int64]) -> RunCode:
    """The best code for runs that occur so often, by byte and length, shape (256, 260).

    Every length can be coded, also one that did not occur; so can a byte if any of its counts is not 0.
    """
    matches = _matches()
    lengths = _lengths(_symbol_counts(counts, matches[0]))
    codes, sizes = _codes(lengths), np.array(lengths, np.uint64)
    return RunCode(
        _runs(codes, sizes, matches),
        _header(lengths),
        codes[END_OF_BLOCK] | sizes[END_OF_BLOCK] << np.uint64(SIZE_SHIFT),
    )


def _matches() -> NDArray[np.uint64]:
    """Of matches of 3 to 258 bytes: their symbols, the values of their extra bits and these bits' numbers.

    Shape (3, 256); see section 3.2.5.
    """
    matches = [(254 + length, 0, 0) for length in range(_SHORTEST_MATCH, 11)]
    for length in range(11, LONGEST_RUN - 1):
        # From 11 on four symbols share each number of extra bits.
        extra = (length - 3).bit_length() - 3
        matches.append((257 + 4 * extra + ((length - 3) >> extra), (length - 3) & ((1 << extra) - 1), extra))
    return np.array([*matches, (_SYMBOLS - 1, 0, 0)], np.uint64).T


def _symbol_counts(counts: NDArray[np.int64], matches: NDArray[np.uint64]) -> list[int]:
    """How often each symbol will be put."""
    literals = np.ones(LONGEST_RUN + 1, np.int64)
    literals[: _SHORTEST_MATCH + 1] = range(_SHORTEST_MATCH + 1)
    symbols = np.concatenate((counts @ literals, np.ones(_SYMBOLS - 256, np.int64)))
    np.add.at(symbols, matches.astype(np.intp), counts.sum(axis=0)[_SHORTEST_MATCH + 1 :])
    return [int(count) for count in symbols]


@njit(cache=True, nogil=True)
def _runs(
    codes: NDArray[np.uint64], sizes: NDArray[np.uint64], matches: NDArray[np.uint64]
) -> NDArray[np.uint64]:
    """Codes of all runs: one to three literals, or a literal and a match."""
    runs = np.zeros((256, LONGEST_RUN + 1), np.uint64)
    shift = np.uint64(SIZE_SHIFT)
    for byte in range(256):
        one, size = codes[byte], sizes[byte]
        bits, taken = one, size
        for length in range(1, _SHORTEST_MATCH + 1):
            runs[byte, length] = bits | taken << shift
            bits |= one << taken
            taken += size
        for k in range(matches.shape[1]):
            symbol = matches[0, k]
            match = codes[symbol] | matches[1, k] << sizes[symbol]
            # The last bit of a match, a 0, is the code of distance 1.
            taken = size + sizes[symbol] + matches[2, k] + np.uint64(1)
            runs[byte, _SHORTEST_MATCH + 1 + k] = one | match << size | taken << shift
    return runs


def _lengths(counts: list[int]) -> list[int]:
    """Lengths of a Huffman code for symbols that occur so often; 0 for those that do not.

    If a code would be longer than deflate allows, rare symbols are taken for more frequent ones.
    """
    least = sum(counts) >> _LONGEST_CODE
    while True:
        heap = [(max(count, least), node) for node, count in enumerate(counts) if count]
        heapq.heapify(heap)
        parents: dict[int, int] = {}
        node = len(counts)
        while len(heap) > 1:
            few, some = heapq.heappop(heap)
            more, others = heap[0]
            parents[some] = parents[others] = node
            heapq.heapreplace(heap, (few + more, node))
            node += 1
        depths = {node - 1: 0}
        for child in sorted(parents, reverse=True):
            depths[child] = depths[parents[child]] + 1
        if max(depths.values()) <= _LONGEST_CODE:
            return [depths.get(symbol, 0) for symbol in range(len(counts))]
        least += least + 1


def _codes(lengths: list[int]) -> NDArray[np.uint64]:
    """The codes of these lengths, first bit lowest (section 3.2.2)."""
    codes = np.zeros(len(lengths), np.uint64)
    code, size = 0, 0
    for length, symbol in sorted((length, symbol) for symbol, length in enumerate(lengths) if length):
        code <<= length - size
        size = length
        codes[symbol] = code
        code += 1
    return _reversed(codes, np.array(lengths, np.uint64))


def _header(lengths: list[int]) -> NDArray[np.uint64]:
    """A block that is not the last, and its codes: 16 lengths of 4 bits each spell them (section 3.2.7)."""
    distances = [1, 1]
    puts = [(0b100, 3), (len(lengths) - 257, 5), (len(distances) - 1, 5), (15, 4)]
    puts += [(0, 3)] * 3 + [(4, 3)] * 16  # the symbols that repeat a length are not used
    bits, sizes = np.array(puts, np.uint64).T
    spelt = _reversed(np.array(lengths + distances, np.uint64), np.uint64(4))
    return np.concatenate((_packed(bits, sizes), _packed(spelt, np.uint64(4))))


def _packed(bits: NDArray[np.uint64], size: NDArray[np.uint64] | np.uint64) -> NDArray[np.uint64]:
    return bits | size << np.uint64(SIZE_SHIFT)


def _reversed(bits: NDArray[np.uint64], sizes: NDArray[np.uint64] | np.uint64) -> NDArray[np.uint64]:
    """The lowest `sizes` bits, the first one last."""
    turned = np.zeros_like(bits)
    for k in range(_LONGEST_CODE):
        turned = turned << np.uint64(1) | bits >> np.uint64(k) & np.uint64(1)
    return turned >> (np.uint64(_LONGEST_CODE) - sizes)
