"""Mutations of a file's or a message's bytes, as damage and malice make them."""

import random
import re

from hypothesis import strategies as st

SEEDS = st.integers(0, 2**64 - 1).map(random.Random)
"""What `mutated` takes its chances from, in tests by hypothesis."""
_LONGEST = 2_000_000
_NUMBER = re.compile(rb"-?\d+(\.\d+)?")
_NUMBERS = (
    *(b"0", b"-0", b"-1", b"1e999", b"-1e999", b"nan", b"inf", b"1e-320", b"1e18", b"9223372036854775807"),
    *(b"18446744073709551616", b"1" * 400, b"9" * 5000, b"0x7fffffff", b"1_000", b"1:30", b"1000000000", b""),
)
_WORDS = (
    *(
        b"[",
        b"]",
        b"{",
        b"}",
        b"[" * 500,
        b'{"a":' * 200,
        b"(" * 500,
        b"&a [*a]",
        b"*a",
        b"<<: ",
        b"!!python/none ",
    ),
    *(
        b"\n",
        b"\r",
        b"\t",
        b" ",
        b",",
        b"#",
        b'"',
        b"\\ud800",
        b"\x00",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"null",
        b"/dev/zero",
    ),
    *(b"\x7f\xff\xff\xff", b"\xff\xff\xff\xff", b"\xff" * 8, b"\x00" * 8, b"PK\x01\x02", b"\x1f\x8b\x08\x00"),
)


def mutated(rng: random.Random, content: bytes) -> bytes:
    """A content with one to four changes: bits, pieces, numbers and words of it, or its end."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = rng.choice(_CHANGES)(rng, content)[:_LONGEST]
    return content


def _bits(rng: random.Random, content: bytes) -> bytes:
    changed = bytearray(content or b"\0")
    for _ in range(rng.choice((1, 1, 8))):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(rng: random.Random, content: bytes) -> bytes:
    return content[: rng.randint(0, len(content))]


def _piece(rng: random.Random, content: bytes) -> tuple[int, int]:
    begin = rng.randint(0, len(content))
    return begin, min(len(content), begin + int(rng.paretovariate(0.5)))


def _left_out(rng: random.Random, content: bytes) -> bytes:
    begin, end = _piece(rng, content)
    return content[:begin] + content[end:]


def _spliced(rng: random.Random, content: bytes) -> bytes:
    begin, end = _piece(rng, content)
    at = rng.randint(0, len(content))
    return content[:at] + content[begin:end] * rng.choice((1, 1, 2, 1000)) + content[at:]


def _inserted(rng: random.Random, content: bytes) -> bytes:
    at = rng.randint(0, len(content))
    word = rng.choice(_WORDS)
    return content[:at] + word + content[at + rng.choice((0, len(word))) :]


def _blown_up(rng: random.Random, content: bytes) -> bytes:
    """One of its numbers is another."""
    numbers = list(_NUMBER.finditer(content, 0, 100_000))
    if not numbers:
        return _bits(rng, content)
    number = rng.choice(numbers)
    return content[: number.start()] + rng.choice(_NUMBERS) + content[number.end() :]


_CHANGES = (_bits, _cut, _left_out, _spliced, _inserted, _blown_up, _blown_up)
