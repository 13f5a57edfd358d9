"""`ogm quality`: maps of logs, judged by scans that are held out of them."""

import json
import re
import shutil

import pytest
from PIL import Image

FIGURES = ["bits", "hit", "unknown", "short", "long", "false_free", "free_m2", "occupied_m2"]
LAB = ["--resolution", "0.1"]


def judged(ogm, *args):
    ended = ogm.call("quality", *args, "--json")
    assert (ended.code, ended.err) == (0, "")
    return json.loads(ended.out)


def test_figures_are_those_of_a_map_without_the_held_out_scans(ogm, lab_recording):
    found = judged(ogm, lab_recording, *LAB, "--models", "bresenham,sector")
    assert list(found) == ["bresenham", "sector"]
    for name, flags in (("bresenham", []), ("sector", ["--sensor-model", "sector"])):
        assert list(found[name]) == [str(lab_recording)]
        figures = found[name][str(lab_recording)]
        assert list(figures) == FIGURES
        assert ogm.call("build", lab_recording, *LAB, *flags, "--hold-out", 10, "--out", name).code == 0
        built = json.loads((ogm.folder / name / "quality.json").read_text())
        assert {"bits": figures["bits"], "hit": figures["hit"]}.items() <= built["held_out"].items()
        areas = [figures["free_m2"], figures["occupied_m2"]]
        assert areas == pytest.approx([built["free_m2"], built["occupied_m2"]])
        assert judged(ogm, lab_recording, *LAB, *flags) == {name: found[name]}
    counted = judged(ogm, lab_recording, *LAB, "--models", "rate")["rate"][str(lab_recording)]
    assert counted == judged(ogm, lab_recording, *LAB, "--cell-model", "rate")["rate"][str(lab_recording)]
    assert counted["bits"] > found["bresenham"][str(lab_recording)]["bits"] + 0.1
    both = [found[name][str(lab_recording)] for name in ("bresenham", "sector")]
    assert both[0]["bits"] != both[1]["bits"]


@pytest.mark.parametrize(
    ("flags", "integrated", "held"),
    [([], 198, 22), (["--hold-out", 3], 147, 73), (["--every", 2], 99, 11), (["--blocks"], 200, 20)],
)
def test_the_table_has_a_line_for_each_log_and_model(ogm, lab_recording, flags, integrated, held):
    shutil.copy(lab_recording, ogm.folder / "again.jsonl")
    logs = [lab_recording, "again.jsonl"] if not flags else [lab_recording]
    ended = ogm.call("quality", *logs, *LAB, *flags, "--models", "dda,bresenham")
    assert (ended.code, ended.err) == (0, "")
    table, reports = (part.splitlines() for part in ended.out.split("\n\n"))
    assert table[0].split("  ")[0].strip() == "log"
    names = [line.split("  ")[0] for line in table[1:]]
    assert names == [name for name in ("lab.jsonl", "again.jsonl")[: len(logs)] for _ in range(2)] + [
        "mean of 2 logs"
    ] * (2 * len(logs) - 2)
    assert [re.split(" {2,}", line)[1] for line in table[1:3]] == ["dda", "bresenham"]
    assert reports[0] == f"{logs[0]}: 220 scans read, {integrated} integrated, {held} held out"
    figures = judged(ogm, lab_recording, *LAB, *flags)["bresenham"][str(lab_recording)]
    assert f"{figures['bits']:.2f}" in table[2]
    assert f"{figures['hit']:.3f}" in table[2]


def test_the_figure_shows_every_model(ogm, lab_recording):
    ended = ogm.call("quality", lab_recording, *LAB, "--models", "bresenham,dda", "--figure", "reliable.svg")
    assert (ended.code, ended.err) == (0, "")
    drawn = (ogm.folder / "reliable.svg").read_text()
    assert drawn.count("<!-- bresenham -->") == drawn.count("<!-- dda -->") == 1
    assert ogm.call("quality", lab_recording, *LAB, "--figure", "reliable.png").code == 0
    with Image.open(ogm.folder / "reliable.png") as picture:
        assert picture.size == (1080, 1380)


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--models", "bresenham,rays"], "--models: 'rays' is none of bresenham, dda, sector"),
        (
            ["--models", "dda", "--traversal", "dda"],
            "--models says how each map is made: leave out --trav",
        ),
        (["--hold-out", 1], "--hold-out: 2 or more is needed, got 1"),
        (["--every", 0], "--every: 1 or more is needed, got 0"),
        (["lab.jsonl"], "lab.jsonl: this log is given twice"),
        (["--hold-out", 1000], "no scan is held out: a longer log, or --hold-out 2, is needed"),
        (["--figure", "x.bmp"], "--figure x.bmp: a name that ends in one of .png, .pdf, .svg is needed"),
        (["missing.jsonl"], "missing.jsonl: "),
    ],
)
def test_what_cannot_be_judged_is_refused(ogm, lab_recording, flags, said):
    shutil.copy(lab_recording, ogm.folder / "lab.jsonl")
    ended = ogm.call("quality", "lab.jsonl", *flags)
    assert (ended.code, ended.out) == (2, "")
    assert said in ended.err
    assert ended.err.count("\n") == 1
