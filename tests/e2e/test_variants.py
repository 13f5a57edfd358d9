"""The tables of docs/variants.md are what their script measures."""

import importlib.util
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def variants():
    spec = importlib.util.spec_from_file_location("variants", DOCS / "variants.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def figures(table):
    """{variant: its numbers}."""
    rows = [row.strip("|").split("|") for row in table.splitlines() if row.startswith("| `")]
    return {
        name.strip(): [float(re.match(r" *([\d.]+)", cell)[1]) for cell in cells] for name, *cells in rows
    }


def printed(name):
    text = (DOCS / "variants.md").read_text(encoding="utf-8")
    return figures(re.search(f"<!-- table {name} -->(.*?)<!-- end of table -->", text, re.DOTALL)[1])


def assert_same(found, expected):
    assert list(found) == list(expected) == ["`beam`, `bresenham`", "`beam`, `dda`", "`sector`", "`rate`"]
    for name, numbers in found.items():
        assert numbers == pytest.approx(expected[name], rel=2e-3, abs=2e-3), name


def test_the_lab(variants, tmp_path):
    found = figures(variants.lab_table(tmp_path))
    assert_same(found, printed("lab"))
    assert all(len(numbers) == 7 and 0.7 < min(numbers[:4]) <= 1.0 for numbers in found.values())


@pytest.mark.parametrize("building", ["intel", "freiburg-079"])
def test_a_recorded_building(variants, datasets, building):
    log = datasets / variants.BUILDINGS[building]
    found = figures(variants.building_table(log, variants.DENSE.get(building, [])))
    assert_same(found, printed(building))
    assert found["`rate`"][0] - 0.7 > found["`beam`, `bresenham`"][0]


def test_a_table_is_written_between_its_marks(variants):
    page = (
        "a\n<!-- table x -->\nold\n<!-- end of table -->\nb\n<!-- table y -->\nkept\n<!-- end of table -->\n"
    )
    assert variants.with_table(page, "x", "| new |\n") == page.replace("old", "| new |")
