"""Decimals that are read by a kernel are those that Python reads, or are left to Python."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.logs.decimals import read_decimals
from ogm_core.logs.recorded import text_ranges

PLAIN = st.from_regex(r"-?(0|[1-9][0-9]{0,8})(\.[0-9]{1,6})?", fullmatch=True)
ALMOST = st.text('0123456789.-+e_"infa', min_size=1, max_size=20)
NOT_FINITE = {'"inf"': np.inf, '"-inf"': -np.inf, '"nan"': np.nan}


def by_json(text):
    """What the JSON reader makes of a list of ranges; None if it does not take it."""
    try:
        values = json.loads(text, parse_constant=lambda _: "no")
        return text_ranges(
            [NOT_FINITE[f'"{value}"'] if isinstance(value, str) else value for value in values]
        )
    except (ValueError, KeyError, TypeError, OverflowError):
        return None


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
    assert read_decimals(b"1,2", 3, commas=True) is None


@pytest.mark.parametrize(
    "text", ["1 2", "1,,2", "1, ,2", ",1,2", "1,x", "1;2", '1,"x"', '1,"-nan"', '1,"inf', "1,"]
)
def test_commas_stand_between_all(text):
    assert read_decimals(text.encode(), 2, commas=True) is None


def test_without_commas_they_are_not_plain():
    assert read_decimals(b"1,2", 2) is None


@given(st.lists(st.one_of(PLAIN, st.sampled_from(sorted(NOT_FINITE))), min_size=1, max_size=30), st.data())
def test_a_list_of_plain_decimals_is_read_as_json(numbers, data):
    blanks = st.sampled_from(["", " ", "\t "])
    text = ",".join(data.draw(blanks) + number + data.draw(blanks) for number in numbers)
    read = read_decimals(text.encode(), len(numbers), commas=True)
    if any(number.startswith("-") and set(number) <= set("-0.") for number in numbers):
        assert read is None
        return
    ranges, end = read
    assert text[end:].strip(" \t") == ""
    assert ranges.tobytes() == by_json(f"[{text}]").tobytes()


@given(st.lists(st.one_of(PLAIN, ALMOST), min_size=1, max_size=3))
def test_nothing_is_read_as_another_number(numbers):
    """What the kernel takes, the careful readers take, and make the same of."""
    comma = read_decimals(",".join(numbers).encode(), len(numbers), commas=True)
    if comma is not None and comma[1] == len(",".join(numbers)):
        assert comma[0].tobytes() == by_json(f"[{','.join(numbers)}]").tobytes()
    blank = read_decimals(" ".join(numbers).encode(), len(numbers))
    if blank is not None and blank[1] == len(" ".join(numbers)):
        assert blank[0].tobytes() == text_ranges(list(map(float, numbers))).tobytes()


@given(st.floats(0.0, 1000.0, width=32))
def test_the_shortest_text_of_a_float32_is_read_exactly(value):
    text = np.format_float_positional(np.float32(value), trim="0")
    read = read_decimals(text.encode(), 1)
    if read is not None:
        assert read[0][0] == np.float32(float(text))
    else:
        assert len(text) > 17
