"""`ogm compare`: saved maps of one lattice, cell by cell."""

import json

import numpy as np
import pytest
from PIL import Image


@pytest.fixture(scope="module")
def two_maps(module_ogm, lab_recording):
    """The folder of the lab's map by beams, and by sectors; of one in smaller cells, of counts."""
    for name, flags in (
        ("beams", ["--resolution", 0.1]),
        ("areas", ["--resolution", 0.1, "--sensor-model", "sector"]),
        ("fine", []),
        ("counts", ["--resolution", 0.1, "--cell-model", "rate"]),
    ):
        assert module_ogm.call("build", lab_recording, "--out", name, *flags).code == 0
    return module_ogm


def states(folder, name):
    """0 unknown or undecided, 1 free, 2 occupied, and where the first cell lies."""
    with np.load(folder / name / "map.npz") as npz:
        p = 1 / (1 + np.exp(-npz["log_odds"].astype(float)))
        return np.where(p > 0.65, 2, np.where(p < 0.196, 1, 0)), npz["offset"], ~np.isnan(npz["log_odds"])


def test_classes_and_shares(two_maps):
    ended = two_maps.call("compare", "beams/map.npz", "areas/map.npz", "--json")
    assert (ended.code, ended.err) == (0, "")
    found = json.loads(ended.out)
    (a, place, known), (b, there, _) = (states(two_maps.folder, name) for name in ("beams", "areas"))
    wide = np.zeros((2, 400, 400), int)
    for canvas, cells, (ix, iy) in ((wide[0], a, place), (wide[1], b, there)):
        canvas[200 + iy : 200 + iy + len(cells), 200 + ix : 200 + ix + cells.shape[1]] = cells
    for k, name in ((1, "free"), (2, "occupied")):
        both, either = np.sum((wide == k).all(axis=0)), np.sum((wide == k).any(axis=0))
        assert found["cells"][name][name] == both
        assert found["iou"][name] == pytest.approx(both / either)
        assert sum(found["cells"][name].values()) == np.sum(a == k)
        assert sum(row[name] for row in found["cells"].values()) == np.sum(b == k)
    assert sum(sum(row.values()) for name, row in found["cells"].items() if name != "unknown") == known.sum()
    assert 0.5 < found["alike"] < 1.0
    ended = two_maps.call("compare", "beams/map.npz", "areas/map.npz")
    assert f"intersection over union: occupied {found['iou']['occupied']:.4f}, free" in ended.out
    assert ended.out.splitlines()[2].split() == ["occupied", *map(str, found["cells"]["occupied"].values())]


def test_a_map_equals_its_ros_map_but_for_what_is_undecided(two_maps):
    found = json.loads(two_maps.call("compare", "beams/map.npz", "beams/map.yaml", "--json").out)
    assert found["iou"] == {"occupied": 1.0, "free": 1.0}
    assert found["cells"]["undecided"]["unknown"] > 0


def test_maps_of_counts_are_compared_in_their_fine_cells(two_maps):
    ended = two_maps.call("compare", "counts/map.npz", "fine/map.npz", "--json")
    assert (ended.code, ended.err) == (0, "")
    found = json.loads(ended.out)
    assert found["alike"] > 0.9
    built = json.loads((two_maps.folder / "counts/quality.json").read_text())
    for name in ("free", "occupied"):
        assert sum(found["cells"][name].values()) * 0.05**2 == pytest.approx(built[f"{name}_m2"])


def test_maps_of_counts_are_compared_with_others_in_cells_as_wide(two_maps):
    """Its own map.yaml has these cells; of log odds each cell counts once, whichever is first."""
    ended = two_maps.call("compare", "counts/map.npz", "counts/map.yaml", "--json")
    assert (ended.code, ended.err) == (0, "")
    found = json.loads(ended.out)
    assert (found["resolution"], found["iou"]) == (0.1, {"occupied": 1.0, "free": 1.0})
    ended = two_maps.call("compare", "beams/map.npz", "counts/map.npz")
    assert (ended.code, ended.err) == (0, "")
    told = "counts/map.npz: in the cells of 0.1 m in which its beams were counted"
    assert ended.out.splitlines()[0] == told
    here, there = (
        json.loads(two_maps.call("compare", *names, "--json").out)
        for names in (("beams/map.npz", "counts/map.npz"), ("counts/map.npz", "beams/map.npz"))
    )
    assert here["cells"]["free"]["occupied"] == there["cells"]["occupied"]["free"]
    assert here["alike"] == there["alike"] > 0.9
    a, _, _ = states(two_maps.folder, "beams")
    assert sum(here["cells"]["free"].values()) == np.sum(a == 1)
    own = json.loads(two_maps.call("compare", "counts/map.npz", "fine/map.npz", "--json").out)
    assert own["resolution"] == 0.05


def test_the_picture_covers_both_maps(two_maps):
    ended = two_maps.call("compare", "beams/map.npz", "areas/map.npz", "--picture", "differ.png")
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.splitlines()[-1].startswith("differ.png: black and white: occupied, free in both;")
    (a, place, _), (b, there, _) = (states(two_maps.folder, name) for name in ("beams", "areas"))
    low = np.minimum(place, there)
    high = np.maximum(place + a.shape[::-1], there + b.shape[::-1])
    with Image.open(two_maps.folder / "differ.png") as picture:
        assert picture.size == tuple(high - low)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (["fine/map.npz"], "fine/map.npz: its cells are 0.05 m, those of beams/map.npz 0.1 m: maps of one"),
        (["missing.npz"], "missing.npz: cannot be read: No such file or directory"),
        (["beams/quality.json"], "beams/quality.json: "),
        (["areas/map.npz", "--picture", "x.jpg"], "--picture x.jpg: a name that ends in .png is needed"),
        (["areas/map.npz", "--picture", "no/x.png"], "--picture no/x.png: cannot be written: No such file"),
    ],
)
def test_what_cannot_be_compared_is_refused(two_maps, args, said):
    ended = two_maps.call("compare", "beams/map.npz", *args)
    assert (ended.code, ended.out) == (2, "")
    assert said in ended.err
    assert ended.err.count("\n") == 1
