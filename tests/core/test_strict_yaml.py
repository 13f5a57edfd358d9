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
