"""`ogm merge`: maps of parts of a log, as files, make the map of the whole log."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def parts(module_ogm, lab_recording):
    """The folder of a log's map of counts, of those of its two halves, and of one of log odds."""
    lines = lab_recording.read_text().splitlines(keepends=True)
    here = module_ogm.folder
    (here / "first.jsonl").write_text("".join(lines[: len(lines) // 2]))
    (here / "second.jsonl").write_text("".join(lines[len(lines) // 2 :]))
    for log, name, model in (
        (lab_recording, "whole", "rate"),
        (here / "first.jsonl", "first", "rate"),
        (here / "second.jsonl", "second", "rate"),
        (here / "first.jsonl", "lines", "log_odds"),
    ):
        ended = module_ogm.call("build", log, "--out", name, "--resolution", 0.1, "--cell-model", model)
        assert ended.code == 0
    return module_ogm


@pytest.mark.parametrize("order", [("first", "second"), ("second", "first")])
def test_two_halves_of_a_log_make_its_map(parts, order):
    ended = parts.call("merge", *(f"{name}/map.npz" for name in order), "-o", "merged.npz")
    assert (ended.code, ended.err) == (0, "")
    assert (parts.folder / "merged.npz").read_bytes() == (parts.folder / "whole/map.npz").read_bytes()
    with np.load(parts.folder / "merged.npz") as merged:
        height, width = merged["log_odds"].shape
    assert ended.out == f"merged.npz: 2 maps, {width} x {height} cells of 0.05 m\n"


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["first/map.npz", "-o", "m.npz"], "two maps at least"),
        (
            ["first/map.npz", "lines/map.npz", "-o", "m.npz"],
            "lines/map.npz: it keeps no counts, and log",
        ),
        (["first/map.npz", "./first/map.npz", "-o", "m.npz"], "first/map.npz is given twice"),
        (
            ["first/map.npz", "second/map.npz", "-o", "m.png"],
            "--out m.png: a name that ends in .npz",
        ),
        (["first/map.npz", "none.npz", "-o", "m.npz"], "none.npz: cannot be read"),
        (["first/map.npz", "first/map.pgm", "-o", "m.npz"], "first/map.pgm: not a map that was saved here"),
        (["first/map.npz", "second/map.npz", "-o", "gone/m.npz"], "--out gone/m.npz: cannot be written"),
    ],
)
def test_what_does_not_add_up_is_refused_in_a_line(parts, args, message):
    ended = parts.call("merge", *args)
    assert ended.code == 2
    assert message in ended.err
    assert len(ended.err.splitlines()) == 1
    assert not (parts.folder / "m.npz").exists()


def test_a_map_for_which_there_is_no_memory_is_told_of_in_a_line(parts, monkeypatch):
    def refused(_):
        raise MemoryError

    monkeypatch.setattr("ogm_core.files.merged_maps.merge_maps", refused)
    ended = parts.call("merge", "first/map.npz", "second/map.npz", "-o", "m.npz")
    assert ended.code == 1
    assert ended.err == "ogm: the system has no memory left for the merged map\n"
