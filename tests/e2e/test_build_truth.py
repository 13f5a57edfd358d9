"""`ogm build --world --figure`: how far the map is from the truth, and the picture of both."""

import functools
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

import naive_truth
from ogm_core.lattice import Lattice
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.worlds import lab
from ogm_services.results.figure import OBSTACLES, ROBOTS, UNKNOWN

FIGURES = ("accuracy", "precision", "recall", "iou", "log_loss")
HALL = """
name: hall
walls: [[-4, -3, 4, -3], [4, -3, 4, 3], [4, 3, -4, 3], [-4, 3, -4, -3]]
circles: [[1, 1, 0.5]]
path: {circle: [-1, 0, 1], poses: 40}
"""


def truth_of(ogm, name):
    return json.loads((ogm.folder / name / "quality.json").read_text())["truth"]


def naively(ogm, name, world):
    """The figures of a written map, from every cell by itself."""
    arrays = ogm.map(f"{name}/map.npz")
    lattice = Lattice(float(arrays["resolution"]), tuple(arrays["anchor"].tolist()))
    ix, iy = arrays["offset"].tolist()
    log_odds = arrays["log_odds"].astype(float)
    known = {
        (ix + column, iy + row): 1 / (1 + np.exp(-log_odds[row, column]))
        for row, column in np.argwhere(~np.isnan(log_odds)).tolist()
    }
    is_true = functools.cache(lambda cell: naive_truth.is_occupied(world, lattice, cell, number=float))
    return naive_truth.truth_figures(known, is_true)


def count(path, colour):
    """How many pixels of a picture come close to a colour."""
    with Image.open(io.BytesIO(path.read_bytes())) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    return int((np.abs(pixels - list(bytes.fromhex(colour[1:]))).sum(axis=2) < 30).sum())


def test_the_lab_as_the_textbook_has_it(ogm, lab_recording):
    flags = ("--preset", "lab", "--world", "lab")
    ended = ogm.call("build", lab_recording, "--out", "built", *flags, "--figure", "lab.png")
    assert (ended.code, ended.err) == (0, "")
    figures = truth_of(ogm, "built")
    assert tuple(figures) == FIGURES
    assert figures == pytest.approx(naively(ogm, "built", lab()), rel=1e-9)
    assert 0.99 < figures["accuracy"] < 1.0
    assert 0.99 < figures["precision"] <= 1.0
    assert 0.94 < figures["recall"] < 0.97  # the corners are hardly seen
    assert 0.88 < figures["iou"] < 0.93
    assert 0.02 < figures["log_loss"] < 0.035
    said = re.fullmatch(
        r"built: 220 scans read, 220 integrated\nbuilt: against the true world lab: accuracy ([\d.]+), "
        r"precision ([\d.]+), recall ([\d.]+), iou ([\d.]+), log loss ([\d.]+)\n",
        ended.out,
    )
    assert list(map(float, said.groups())) == pytest.approx(list(figures.values()), abs=0.0006)
    metre = 80  # 10 cells of 8 pixels
    assert count(ogm.folder / "lab.png", OBSTACLES) > (80 + 2 * np.pi * 4.7) * metre
    assert count(ogm.folder / "lab.png", ROBOTS[0]) > 2 * np.pi * 6 * metre
    assert count(ogm.folder / "lab.png", UNKNOWN) > (20.8**2 - 20**2 + 3) * metre**2


def test_a_world_file_and_an_unbounded_map_of_two_robots(ogm):
    ogm.file("hall.yaml", HALL)
    simulated = ogm.call(
        "simulate", "--world", "hall.yaml", "--robots", 2, "--scans", 40, "--seed", 2, "--out", "hall.jsonl"
    )
    assert simulated.code == 0
    flags = ("--world", "hall.yaml", "--figure", "built/hall.png")
    ended = ogm.call("build", "hall.jsonl", "--out", "built", *flags, "--hold-out", 4)
    assert (ended.code, ended.err) == (0, "")
    assert "built: against the true world hall: accuracy 0.9" in ended.out
    figures = truth_of(ogm, "built")
    # The map's npz has log odds in float32.
    assert figures == pytest.approx(
        naively(ogm, "built", world_named(str(ogm.folder / "hall.yaml"))), rel=1e-5
    )
    assert figures["accuracy"] > 0.97
    assert figures["precision"] == 1.0
    assert 0.9 < figures["recall"] <= 1.0
    for colour in (OBSTACLES, *ROBOTS[:2]):
        assert count(ogm.folder / "built" / "hall.png", colour) > 1000


def test_without_a_world_there_is_no_truth(ogm, lab_recording):
    ended = ogm.call("build", lab_recording, "--out", "built", "--figure", "lab.svg", "--resolution", 0.2)
    assert ended.code == 0
    assert ended.out == "built: 220 scans read, 220 integrated\n"
    assert "truth" not in json.loads((ogm.folder / "built" / "quality.json").read_text())
    drawn = (ogm.folder / "lab.svg").read_text()
    assert drawn.startswith("<?xml")
    assert OBSTACLES not in drawn


def test_what_is_wrong_is_said_before_the_log_is_read_and_nothing_is_written(ogm):
    ogm.file("empty.yaml", "name: empty\n")
    (ogm.folder / "stub" / "matplotlib").mkdir(parents=True)
    ogm.file("stub/matplotlib/__init__.py", "raise ImportError('gone')")
    expected = {
        ("--world", "nowhere"): "world 'nowhere': no such file, nor a built-in world (lab, office)",
        ("--world", "empty.yaml"): "world 'empty.yaml': the world is empty",
        ("--figure", "lab.jpg"): "--figure lab.jpg: a name that ends in one of .png, .pdf, .svg is needed",
        ("--figure", "nowhere/lab.png"): "--figure nowhere/lab.png: cannot be written: No such file",
        ("--figure", "built/map.png"): "--figure built/map.png: the map's own picture has that name",
    }
    without = ogm.start(
        "build", "missing.jsonl", "--out", "built", "--figure", "lab.png", PYTHONPATH=str(ogm.folder / "stub")
    )
    unsettled = ogm.start(
        "build", "missing.jsonl", "--out", "built", "--figure", "lab.png", MPLBACKEND="nothing"
    )
    for flags, text in expected.items():
        build = ogm.call("build", "missing.jsonl", "--out", "built", *flags)
        assert build.complaint(2).startswith(f"ogm: {text}")
    assert without.wait().complaint(2) == "ogm: --figure needs matplotlib: install zenoh-ogm[plot]\n"
    assert "matplotlib does not accept its own settings: Key backend" in unsettled.wait().complaint(2)
    assert sorted(path.name for path in ogm.folder.iterdir()) == ["empty.yaml", "stub"]


def test_a_log_that_gives_no_map_gives_no_figure_either(ogm):
    ogm.file("empty.jsonl", "")
    ended = ogm.call("build", "empty.jsonl", "--out", "built", "--world", "lab", "--figure", "built/lab.png")
    assert "holds no scan" in ended.complaint(2)
    assert [path.name for path in ogm.folder.iterdir()] == ["empty.jsonl"]
