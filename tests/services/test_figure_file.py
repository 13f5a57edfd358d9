"""The file of a figure: what is refused before the work, and what is left alone."""

import sys
from pathlib import Path

import pytest

from ogm_core.errors import BadInput
from ogm_services.results.figure_file import check_figure, write_figure


def refused(path, out):
    with pytest.raises(BadInput) as caught:
        check_figure(path, out)
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_names_of_other_formats_are_refused(tmp_path):
    for name in ("a.jpg", "png", "a.png.gz", "a"):
        assert f"{name}: a name that ends in one of .png, .pdf, .svg is needed" in refused(
            tmp_path / name, tmp_path
        )
    for name in ("a.png", "b.PDF", "c.Svg"):
        check_figure(tmp_path / name, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_files_that_cannot_be_written_are_refused(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.png").mkdir()
    assert "No such file or directory" in refused(tmp_path / "nowhere" / "a.png", tmp_path / "out")
    assert "Not a directory" in refused(tmp_path / "file" / "a.png", tmp_path / "out")
    assert "Is a directory" in refused(tmp_path / "folder.png", tmp_path / "out")
    assert refused(tmp_path / "nowhere" / "a.png", tmp_path).startswith(
        f"--figure {tmp_path}/nowhere/a.png: "
    )
    with pytest.raises(BadInput, match=r"--figure .*folder.png: cannot be written: Is a directory"):
        write_figure(tmp_path / "folder.png", b"")


def test_a_folder_in_which_nothing_can_be_made_is_refused(tmp_path):
    proc = Path("/proc/self")
    for out in (tmp_path, proc):
        assert "cannot be written" in refused(proc / "a.png", out)


def test_an_old_figure_is_left_alone_until_the_new_one_is_there(tmp_path):
    (tmp_path / "a.png").write_bytes(b"old")
    check_figure(tmp_path / "a.png", tmp_path)
    assert (tmp_path / "a.png").read_bytes() == b"old"


def test_a_figure_may_go_into_the_maps_folder_yet_to_be_made(tmp_path):
    check_figure(tmp_path / "x" / "out" / "figure.png", tmp_path / "x" / "out")
    assert not (tmp_path / "x").exists()
    assert "the map's own picture" in refused(tmp_path / "x" / "map.png", tmp_path / "x")
    check_figure(tmp_path / "map.png", tmp_path / "x")


def test_without_matplotlib_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    assert refused(tmp_path / "a.png", tmp_path) == "--figure needs matplotlib: install zenoh-ogm[plot]"
