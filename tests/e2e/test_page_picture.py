"""The pictures of the live page: a demo's page is looked at by a browser, light and dark."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from docs.page_picture import BROWSERS, NAMES, SIZE
from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[2]
SCANS = 3


def take(out, *flags, path=None):
    """Run the script with this PATH."""
    environ = without_settings(os.environ)
    return subprocess.run(
        [sys.executable, "-m", "docs.page_picture", "--out", out, *map(str, flags)],
        cwd=ROOT,
        env=environ if path is None else {**environ, "PATH": str(path)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def test_they_are_taken_of_a_demo_light_and_dark(tmp_path):
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("no Chromium is installed")
    pytest.importorskip("playwright")
    ended = take(tmp_path, "--world", "lab", "--scans", SCANS)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    assert {path.name for path in tmp_path.iterdir()} == {"page-lab.png", "page-lab-dark.png"}
    for name, paper, unknown in (
        ("page-lab.png", (255, 255, 255), (205, 205, 205)),
        ("page-lab-dark.png", (27, 30, 34), (27, 30, 34)),
    ):
        with Image.open(tmp_path / name) as picture:
            assert (picture.format, picture.mode, picture.size) == ("PNG", "P", SIZE)
            pixels = np.asarray(picture.convert("RGB"))
        # The panel's paper at the right edge, and the map's ground, of which the lab's middle leaves enough.
        assert tuple(pixels[-3, -3]) == paper
        assert np.mean(np.all(pixels[:, :700] == unknown, axis=2)) > 0.1


@pytest.mark.parametrize(
    ("program", "said"),
    [
        (None, "Chromium is not installed (none of"),
        ("#!/bin/sh\necho no display >&2\nexit 3\n", "/chromium does not start: "),
    ],
)
def test_without_a_picture_it_says_why_in_a_line(tmp_path, program, said):
    programs, out = tmp_path / "programs", tmp_path / "out"
    programs.mkdir()
    out.mkdir()
    if program is not None:
        if importlib.util.find_spec("playwright") is None:
            pytest.skip("Playwright is not installed")
        (programs / "chromium").write_text(program)
        (programs / "chromium").chmod(0o755)
    ended = take(out, "--world", "lab", "--scans", SCANS, path=programs)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr.startswith("page-picture: ")
    assert said in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("name", NAMES.values())
def test_a_picture_that_is_shown_is_small(name):
    path = ROOT / "docs" / name
    with Image.open(path) as picture:
        assert picture.size == SIZE
    assert path.stat().st_size < 150_000
