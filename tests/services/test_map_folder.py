"""The folder of a finished map: all of its files are new, or none is."""

import json
from pathlib import Path

import numpy as np
import pytest

from ogm_core.cells.arrays import CellArrays
from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadInput, DiskFull
from ogm_core.lattice import Lattice
from ogm_core.snapshot import MapSnapshot
from ogm_services.results.map_folder import check_folder, check_place, write_map

NAMES = ["map.npz", "map.pgm", "map.png", "map.yaml", "quality.json"]


def snapshot():
    cells = np.array([[1.5, -1.5, 0.0]])
    model = LogOdds(cells="float64")
    return MapSnapshot(CellArrays.of(model, cells), model, Lattice(0.1), (0, 0), "epoch", 1, None)


def test_all_files_of_a_map_are_written(tmp_path):
    write_map(tmp_path / "a" / "b", snapshot(), {"scans": 3})
    assert sorted(path.name for path in (tmp_path / "a" / "b").iterdir()) == NAMES
    assert json.loads((tmp_path / "a" / "b" / "quality.json").read_text()) == {"scans": 3}
    assert (tmp_path / "a" / "b" / "map.pgm").read_bytes().endswith(bytes([0, 254, 205]))


@pytest.mark.parametrize("name", NAMES)
def test_a_file_that_cannot_be_written_leaves_the_old_map(tmp_path, name):
    for other in set(NAMES) - {name}:
        (tmp_path / other).write_bytes(b"before")
    (tmp_path / name).mkdir()
    with pytest.raises(BadInput, match=r"^--out .*: cannot be written: Is a directory$"):
        write_map(tmp_path, snapshot(), {})
    assert all((tmp_path / other).read_bytes() == b"before" for other in set(NAMES) - {name})
    assert sorted(path.name for path in tmp_path.iterdir()) == NAMES


def test_a_disk_that_is_full_leaves_the_old_map(tmp_path, disk_full):
    for name in NAMES:
        (tmp_path / name).write_bytes(b"before")
    for quality in ({}, None):
        with pytest.raises(DiskFull, match=r"^--out .*: cannot be written: No space left on device$"):
            write_map(tmp_path, snapshot(), quality)
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == dict.fromkeys(
            NAMES, b"before"
        )


def test_files_take_their_names_one_after_the_other(tmp_path, monkeypatch):
    """All are on disk before; the picture comes before the YAML that places it, what is judged last."""
    named = []
    replace = Path.replace

    def noted(part, target):
        named.append((target.name, len(list(tmp_path.glob(".ogm-*.part")))))
        return replace(part, target)

    monkeypatch.setattr(Path, "replace", noted)
    write_map(tmp_path, snapshot(), {})
    assert named == [("map.npz", 5), ("map.png", 4), ("map.pgm", 3), ("map.yaml", 2), ("quality.json", 1)]


def test_a_folder_that_cannot_be_made_is_found_out_before(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(BadInput, match=r"^--out .*file/out: cannot be written: Not a directory$"):
        check_folder(tmp_path / "file" / "out")
    with pytest.raises(BadInput, match=r"^--out .*file/out: cannot be written: Not a directory$"):
        check_place(tmp_path / "file" / "out")
    check_place(tmp_path / "a" / "b" / "out")
    check_place(Path("of-the-working-folder"))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    check_folder(tmp_path / "out")
    assert [path.name for path in tmp_path.iterdir()] == ["file", "out"]
    (tmp_path / "out" / "map.png").mkdir()
    for check in (check_folder, check_place):
        with pytest.raises(BadInput, match=r"^--out .*out/map.png: cannot be written: Is a directory$"):
            check(tmp_path / "out")
    (tmp_path / "out" / "map.png").rmdir()
    assert list((tmp_path / "out").iterdir()) == []
