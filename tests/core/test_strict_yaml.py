"""YAML as it is read here: numbers are YAML 1.2's, and what is written is read as the same."""

import math

import pytest

from ogm_core.files.strict_yaml import dump_yaml, parse_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("012", 12),  # 10 in YAML 1.1
        ("-010", -10),
        ("08", 8),
        ("0", 0),
        ("+7", 7),
        ("0o14", 12),
        ("0x1F", 31),
        ("1e3", 1000.0),  # a word in YAML 1.1
        ("5.E-2", 0.05),
        (".5", 0.5),
        ("-1.", -1.0),
        ("-.inf", -math.inf),
        ("1:30", "1:30"),  # 90 in YAML 1.1
        ("1_000", "1_000"),  # 1000 in YAML 1.1
        ("0b11", "0b11"),
        ("12 ", 12),
        ("'012'", "012"),
        ("1.2.3", "1.2.3"),
        ("e3", "e3"),
        ("yes", True),
        ("~", None),
    ],
)
def test_numbers_are_those_of_yaml_1_2(text, value):
    read = parse_yaml(f"key: [{text}]")["key"][0]
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize(
    "text",
    [
        "!!float 1:30",
        "!!int 1:30",
        "!!int 1_000",
        "!!float 1_0.5",
        "!!int 0b11",
        "!!float infinity",
        "!!float " + "1:" * 100_000 + "1",  # of base 60, it is no number that has room
    ],
)
def test_a_tag_makes_no_number_of_what_is_none(text):
    with pytest.raises(ValueError, match="not YAML that can be read"):
        parse_yaml(f"key: {text}")


def test_tagged_numbers_are_those_without_a_tag():
    texts = "[!!float 5e-2, !!float -.INF, !!float 7, !!int 012, !!int 0x1F, !!float .nan]"
    *numbers, nan = parse_yaml(texts)
    assert (numbers, math.isnan(nan)) == ([0.05, -math.inf, 7.0, 12, 31], True)


MERGES = ["a0: &a0 {x: 1}", *(f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}]}}" for k in range(1, 60))]
"""Without end for whoever follows them: each line doubles what is made."""


@pytest.mark.parametrize("text", ["\n".join(MERGES), "{<<: {a: 1}}", "{? !!merge x : {a: 1}}"])
def test_merges_are_refused(text):
    with pytest.raises(ValueError, match="<< merges mappings, which is not taken: write out what they hold"):
        parse_yaml(text)


def test_the_text_of_a_merge_is_a_text():
    assert parse_yaml("{'<<': '<<'}") == {"<<": "<<"}


def test_what_is_written_is_read_as_the_same():
    texts = [
        "012",
        "08",
        "1e3",
        "5e-2",
        "0o7",
        "0x1",
        "1:30",
        "1_000",
        "yes",
        "null",
        "-1.",
        ".inf",
        "",
        "a: b",
        "'",
    ]
    value = {"texts": texts, "numbers": [0, -12, 1e-5, 1e300, 0.1 + 0.2, -math.inf], "08": {"1e3": None}}
    assert parse_yaml(dump_yaml(value)) == value


def test_an_error_says_the_line_and_nothing_of_what_reads_it():
    with pytest.raises(
        ValueError, match=r"\(while parsing a flow node did not find .* at line 3, column 1\)$"
    ) as error:
        parse_yaml("a: 1\nb: [\n")
    assert "unicode" not in str(error.value)
