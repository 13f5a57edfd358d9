"""Results with their targets, as they are shown and kept."""

import json

import pytest

from benchmarks.__main__ import PAGE, ROOT, benchmark
from benchmarks.table import Result, as_markdown, as_text, keep, targets, with_unit
from docs.variants import with_table

RESULTS = [
    Result("speed", "fast", 5.251, "x", 5.0),
    Result("speed", "slow", 1.0, "x", 1.25),
    Result("time", "a scan", 1234.4, "us"),
    Result("time", "waiting", 3.0, "ms", 4.0, at_least=False),
    Result("speed", "wrong cells", 1, "", 0, at_least=False),
]


@pytest.mark.parametrize(
    ("value", "target", "at_least", "met"),
    [(2.0, 2.0, True, True), (1.9, 2.0, True, False), (2.0, 2.0, False, True), (2.1, 2.0, False, False)],
)
def test_a_target_is_met_from_its_own_value_on(value, target, at_least, met):
    assert Result("g", "n", value, "x", target, at_least).met is met


def test_no_target_is_neither_met_nor_missed():
    assert Result("g", "n", 1.0, "x").met is None


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.5, "0.500 us"),
        (12.345, "12.3 us"),
        (123.4, "123 us"),
        (45678.9, "45,679 us"),
        (0, "0 us"),
        (7, "7 us"),
    ],
)
def test_values_have_three_digits(value, text):
    assert with_unit(value, "us") == text


def test_markdown_has_a_table_for_every_group():
    assert as_markdown(RESULTS, "Measured") == (
        "# Measured\n"
        "\n## speed\n\n"
        "| what | measured | target | met |\n|---|---|---|---|\n"
        "| fast | 5.25 x | at least 5.00 x | yes |\n"
        "| slow | 1.00 x | at least 1.25 x | **no** |\n"
        "| wrong cells | 1 | at most 0 | **no** |\n"
        "\n## time\n\n"
        "| what | measured | target | met |\n|---|---|---|---|\n"
        "| a scan | 1,234 us |  |  |\n"
        "| waiting | 3.00 ms | at most 4.00 ms | yes |\n"
    )


def test_targets_stand_below_the_name_of_their_group():
    assert targets(RESULTS) == (
        "| what | measured | target | met |\n|---|---|---|---|\n"
        "| **speed** |  |  |  |\n"
        "| fast | 5.25 x | at least 5.00 x | yes |\n"
        "| slow | 1.00 x | at least 1.25 x | **no** |\n"
        "| wrong cells | 1 | at most 0 | **no** |\n"
        "| **time** |  |  |  |\n"
        "| waiting | 3.00 ms | at most 4.00 ms | yes |\n"
    )


def test_text_lines_up():
    assert as_text(RESULTS[2:4]).splitlines() == [
        "",
        "time",
        "  what     measured  target           met",
        "  a scan   1,234 us",
        "  waiting  3.00 ms   at most 4.00 ms  yes",
    ]


def test_kept_results_can_be_read_again(tmp_path):
    keep(RESULTS, tmp_path / "new" / "folder", "Measured")
    kept = json.loads((tmp_path / "new" / "folder" / "results.json").read_text())
    assert [result.pop("met") for result in kept] == [True, False, None, True, False]
    assert [Result(**result) for result in kept] == RESULTS
    assert (tmp_path / "new" / "folder" / "results.md").read_text() == as_markdown(RESULTS, "Measured")


def test_the_page_shows_the_targets_of_the_results_that_are_kept():
    kept = json.loads((ROOT / "benchmarks" / "results" / "results.json").read_text())
    for result in kept:
        del result["met"]
    page = PAGE.read_text(encoding="utf-8")
    assert with_table(page, "speed", targets([Result(**result) for result in kept])) == page
    assert with_table(page, "speed", "| other |\n") != page


def test_a_benchmark_that_is_not_there_is_left_out():
    assert benchmark("weather") is None
    assert callable(benchmark("integration"))
