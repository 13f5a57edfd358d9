"""Decimals that are read by a kernel are those that Python reads, or are left to Python."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.logs.decimals import read_decimals
from ogm_core.logs.recorded import text_ranges

PLAIN = st.from_regex(r"-?(0|[1-9][0-9]{0,8})(\.[0-9]{1,6})?", fullmatch=True)
ALMOST = st.text('0123456789.-+e_"infa', min_size=1, max_size=20)


def by_python(numbers):
    """What Python makes of each of the numbers."""
    return text_ranges(list(map(float, numbers)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"1", 1.0),
        (b"-1.5", -1.5),
        (b"0", 0.0),
        (b"0.0", 0.0),
        (b"0.1", 0.1),
        (b"81.830000", 81.83),
        (b" \t7", 7.0),
        (b"9007199254740991", 2.0**53 - 1),
        (b"0.9007199254740991", 0.9007199254740991),
        (b"0.0000000000000000000001", 1e-22),
    ],
)
def test_a_plain_decimal_is_read(text, expected):
    ranges, end = read_decimals(text, 1)
    assert (ranges.dtype, end) == (np.float32, len(text))
    assert ranges.tolist() == [np.float32(expected)]
    assert not ranges.flags.writeable


@pytest.mark.parametrize(
    "text",
    [
        "", " ", "-", ".", "x", "+1", "1.", ".5", "-.5", "01", "-01", "00", "-0", "-0.0", "--1", "nan", "inf",
        "9007199254740992", "1.5707963267948966", "0.00000000000000000000001", "99999999999999999999999999",
        '"inf"', "\n1", "\v1",
    ],
)  # fmt: skip
def test_what_is_not_plain_is_left(text):
    assert read_decimals(text.encode(), 1) is None


def test_it_says_where_the_last_one_ends():
    for rest in (b"", b" ", b" 4 host", b"x", b"e5", b"_000", b",3", b"\n"):
        ranges, end = read_decimals(b"1 2.25\t 3" + rest, 3)
        assert (ranges.tolist(), end) == ([1.0, 2.25, 3.0], 9)


def test_too_few_are_not_read():
    assert read_decimals(b"1 2", 3) is None


@pytest.mark.parametrize("text", ["1,2", "1, 2", "1;2", "1-2", "1 x", "1 "])
def test_blanks_stand_between_all(text):
    assert read_decimals(text.encode(), 2) is None


@given(st.lists(PLAIN, min_size=1, max_size=30), st.data())
def test_plain_decimals_are_read_as_python_reads_them(numbers, data):
    blanks = st.sampled_from([" ", "\t", "\t "])
    text = "".join(data.draw(blanks) + number for number in numbers) + data.draw(blanks)
    read = read_decimals(text.encode(), len(numbers))
    if any(number.startswith("-") and set(number) <= set("-0.") for number in numbers):
        assert read is None
        return
    ranges, end = read
    assert text[end:].strip(" \t") == ""
    assert ranges.tobytes() == by_python(numbers).tobytes()


@given(st.lists(st.one_of(PLAIN, ALMOST), min_size=1, max_size=3))
def test_nothing_is_read_as_another_number(numbers):
    """What the kernel takes, the careful reader takes, and makes the same of."""
    blank = read_decimals(" ".join(numbers).encode(), len(numbers))
    if blank is not None and blank[1] == len(" ".join(numbers)):
        assert blank[0].tobytes() == by_python(numbers).tobytes()


@given(st.floats(0.0, 1000.0, width=32))
def test_the_shortest_text_of_a_float32_is_read_exactly(value):
    text = np.format_float_positional(np.float32(value), trim="0")
    read = read_decimals(text.encode(), 1)
    if read is not None:
        assert read[0][0] == np.float32(float(text))
    else:
        assert len(text) > 17
