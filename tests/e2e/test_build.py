"""`ogm build`: what it writes, what it judges by, and what it refuses."""

import gzip
import json
import math

import numpy as np
import pytest
from PIL import Image

from ogm_core.logs.recordings import RecordedScan, RecordingReader
from room import S, scan

FILES = {"map.png", "map.pgm", "map.yaml", "map.npz", "quality.json"}
FIGURES = {
    "entropy_bits",
    "mean_entropy_bits",
    "known_m2",
    "free_m2",
    "occupied_m2",
    "consistency",
    "scans",
    "cell_updates",
}
HELD_OUT = {"beams", "median_abs_m", "within_0_1_m", "within_0_2_m", "into_unknown", "bits", "hit"}


def quality(ogm, name="built"):
    return json.loads((ogm.folder / name / "quality.json").read_text())


def test_outputs(ogm, lab_recording):
    ended = ogm.run("build", lab_recording, "--out", "deep/built")
    assert (ended.code, ended.err) == (0, "")
    assert ended.out == "deep/built: 220 scans read, 220 integrated\n"
    out = ogm.folder / "deep/built"
    assert {path.name for path in out.iterdir()} == FILES
    figures = quality(ogm, "deep/built")
    assert figures.keys() == FIGURES
    log_odds, cell = ogm.map("deep/built/map.npz")["log_odds"], 0.05**2
    known = ~np.isnan(log_odds)
    p = 1.0 / (1.0 + np.exp(-log_odds[known].astype(float)))
    assert figures["known_m2"] == pytest.approx(known.sum() * cell)
    assert figures["free_m2"] == pytest.approx(np.sum(p < 0.196) * cell)
    assert figures["occupied_m2"] == pytest.approx(np.sum(p > 0.65) * cell)
    entropy = -np.sum(p * np.log2(p) + (1 - p) * np.log2(1 - p))
    assert figures["entropy_bits"] == pytest.approx(entropy, rel=1e-4)
    assert figures["mean_entropy_bits"] == pytest.approx(entropy / known.sum(), rel=1e-4)
    assert figures["scans"] == 220
    assert figures["cell_updates"] > 1_000_000
    assert 0.5 < figures["consistency"]["hits"] < figures["consistency"]["free"] <= 1.0
    with Image.open(out / "map.png") as png, Image.open(out / "map.pgm") as pgm:
        assert np.array_equal(np.asarray(png), np.asarray(pgm))
        grey = np.asarray(png)[::-1]
    expected = np.full(log_odds.shape, 205)
    expected[known] = np.where(p > 0.65, 0, np.where(p < 0.196, 254, 205))
    np.testing.assert_array_equal(grey, expected)


def test_two_builds_are_equal_byte_for_byte(ogm, lab_recording):
    assert ogm.run("build", lab_recording, "--out", "one").code == 0
    assert ogm.call("build", lab_recording, "--out", "two").code == 0
    for name in FILES:
        assert (ogm.folder / "one" / name).read_bytes() == (ogm.folder / "two" / name).read_bytes()


@pytest.mark.parametrize("n", [2, 7])
def test_hold_out_takes_scan_i_if_i_mod_n_is_half_of_n(ogm, lab_recording, assert_equal_maps, n):
    """Every scan in the file counts, from 0, dropped or not; a malformed line is no scan."""
    lines = lab_recording.read_text().splitlines()
    scans = [line for line in lines if '"scan"' in line]
    never_placed = [line.replace("robot1", "lost") for line in scans[:3]]
    lines[4:4] = [*never_placed, "no scan"]
    kept, held = [], []
    index = 0
    for line in lines:
        out = '"scan"' in line and index % n == n // 2
        index += '"scan"' in line
        (held if out else kept).append(line)
    held = [line for line in held if "lost" not in line]
    ogm.file("all.jsonl", "\n".join(lines))
    ogm.file("kept.jsonl", "\n".join(kept))
    ended = [
        ogm.call("build", "all.jsonl", "--out", "judged", "--hold-out", n),
        ogm.call("build", "kept.jsonl", "--out", "kept"),
    ]
    assert [end.code for end in ended] == [0, 0]
    assert f"223 scans read, {220 - len(held)} integrated, {len(held)} held out" in ended[0].out
    assert_equal_maps(ogm.map("judged/map.npz"), ogm.map("kept/map.npz"))
    figures, without = quality(ogm, "judged"), quality(ogm, "kept")
    judged = figures.pop("held_out")
    assert figures == without
    assert judged.keys() == HELD_OUT
    # Judged are the beams that hit something: the lab's LiDAR sees 8 m, and 0.05 m of that are alpha / 2.
    ranges = np.concatenate([np.float32(json.loads(line)["ranges"]) for line in held])
    assert judged["beams"] == np.sum((ranges > 0.0) & (ranges < 8.0 - 0.05))
    assert 0.8 < judged["within_0_1_m"] <= judged["within_0_2_m"] <= 1.0 - judged["into_unknown"]
    assert judged["median_abs_m"] < 0.05
    assert judged["bits"] > 4.5
    assert 0.8 < judged["hit"] < 1.0


def test_malformed_lines_are_counted_and_quoted(ogm, lab_recording):
    lines = lab_recording.read_text().splitlines()
    lines[1:1] = ["{", '{"type": "map"}', "[" * 100_000]
    ogm.file("bad.jsonl", "\n".join(lines))
    ended = ogm.call("build", "bad.jsonl", "--out", "built")
    assert (ended.code, ended.err) == (0, "")
    assert "220 scans read, 220 integrated, 3 malformed lines (line 2: not JSON" in ended.out
    assert "line 3: type: 'pose' or 'scan' is needed, got 'map'" in ended.out
    assert len(ended.out) < 1000


def test_bad_input_is_one_line_and_nothing_is_written(ogm, lab_recording):
    packed = gzip.compress(lab_recording.read_bytes())
    for name, content in {
        "cut.jsonl.gz": packed[: len(packed) // 2],
        "empty.jsonl": b"",
        "poses.jsonl": lab_recording.read_bytes().splitlines()[0],
        "malformed.jsonl": b"{\n[\n",
        "map.bag": b"#ROSBAG V2.0",
        "file": b"",
    }.items():
        (ogm.folder / name).write_bytes(content)
    (ogm.folder / "folder.jsonl").mkdir()
    expected = {
        "missing.jsonl": "missing.jsonl: cannot be read (No such file or directory)",
        "folder.jsonl": "folder.jsonl: a folder, and no bag: give a log or a bag that is in it",
        "cut.jsonl.gz": "truncated",
        "empty.jsonl": "holds no scan",
        "poses.jsonl": "holds no scan, only 1 poses",
        "malformed.jsonl": "holds no scan; 2 lines are malformed, first line 1: not JSON",
        "map.bag": "map.bag: a bag that is damaged, or of a kind that is not read (ReaderError: ",
    }
    first, *_ = expected
    for name, text in expected.items():
        build = ogm.run if name == first else ogm.call
        complaint = build("build", name, "--out", "built").complaint(2)
        assert complaint.startswith(f"ogm: {name}: ")
        assert text in complaint
    unwritable = ogm.call("build", lab_recording, "--out", "file/built")
    assert "--out file/built: cannot be written" in unwritable.complaint(2)
    assert ogm.call("build", "cut.jsonl.gz", "--out", "file/built").complaint(2) == unwritable.complaint(2)
    assert not (ogm.folder / "built").exists()


def test_a_build_forgets_what_its_log_shows_only_at_first(built):
    """By its stamps, a second a scan at most: 30 scans of a room, and then 16 s of another one."""
    log = [scan(k * S // 20, [2.0] * 360, k, pose=[0, 0, 0]) for k in range(30)]
    log += [scan(k * 100 * S, [1.0] * 360, 30 + k, pose=[30, 0, 0]) for k in range(1, 17)]
    for flags, left in ((), 8.0), (("--half-life", "4"), 8.0 * 2**-4):
        npz, _ = built(log, *flags)
        east = int((20.0 - npz["origin"][0]) / npz["resolution"])
        assert np.nanmax(npz["log_odds"][:, :east]) == pytest.approx(left, abs=0.01)
        assert np.nanmax(npz["log_odds"][:, east:]) == pytest.approx(8.0, abs=0.01)


def test_a_log_that_gives_no_map_is_a_failure(ogm, lab_recording):
    with RecordingReader(lab_recording) as messages:
        scan = next(message.message for message in messages if isinstance(message, RecordedScan))
    fields = {"type": "scan", "robot": "r", "sensor": "s", "stamp": 0, "seq": 0, "pose": [0.0, 0.0, 0.0]}
    fields |= {
        "angle_min": 0.0,
        "angle_increment": math.tau / 360,
        "range_min": 0.0,
        "range_max": scan.range_max,
    }
    ogm.file("blind.jsonl", json.dumps({**fields, "ranges": ["nan"] * 360}))
    only_scans = [line for line in lab_recording.read_text().splitlines() if '"scan"' in line]
    ogm.file("lost.jsonl", "\n".join(only_scans))
    blind = ogm.call("build", "blind.jsonl", "--out", "built")
    lost = ogm.call("build", "lost.jsonl", "--out", "built")
    assert "no scan changed the map (1 scans read, 1 integrated)" in blind.complaint(1)
    assert "no scan changed the map (220 scans read, 0 integrated, 220 dropped: no_pose)" in lost.complaint(1)
    assert not (ogm.folder / "built").exists()


def test_a_map_of_counts_has_cells_half_as_wide_but_for_ros(ogm, lab_recording):
    ended = ogm.run("build", lab_recording, "--out", "built", "--cell-model", "rate")
    assert (ended.code, ended.err) == (0, "")
    out, arrays = ogm.folder / "built", ogm.map("built/map.npz")
    log_odds, cells = arrays["log_odds"], arrays["N"]
    assert (arrays["resolution"], arrays["per_cell"]) == (0.025, 2)
    assert log_odds.shape == arrays["H"].shape == tuple(2 * side for side in cells.shape)
    known = ~np.isnan(log_odds)
    p = 1.0 / (1.0 + np.exp(-log_odds[known].astype(float)))
    expected = np.full(log_odds.shape, 205)
    expected[known] = np.where(p > 0.65, 0, np.where(p < 0.196, 254, 205))
    with Image.open(out / "map.png") as png, Image.open(out / "map.pgm") as pgm:
        np.testing.assert_array_equal(np.asarray(png)[::-1], expected)
        assert pgm.size == cells.shape[::-1]
        assert {0, 254, 205} == set(np.unique(np.asarray(pgm)).tolist())
    assert "resolution: 0.05\n" in (out / "map.yaml").read_text()
    figures = quality(ogm)
    assert figures["known_m2"] == pytest.approx(known.sum() * 0.025**2)
    assert figures["occupied_m2"] == pytest.approx(np.sum(p > 0.65) * 0.025**2)
    assert figures["consistency"]["free"] > 0.9


def test_a_model_that_counts_takes_no_parameters_of_log_odds(ogm, lab_recording):
    for flags in (
        ("--traversal", "dda"),
        ("--cells", "int16"),
        ("--p-occ", "0.8"),
        ("--sensor-model", "sector"),
    ):
        ended = ogm.call("build", lab_recording, "--out", "built", "--cell-model", "rate", *flags)
        assert ended.code == 2
        assert flags[0].removeprefix("--").replace("-", "_") in ended.err
        assert ended.err.count("\n") == 1
