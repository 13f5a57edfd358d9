"""The picture of the live page: a demo's page is looked at by a browser, here one that only pretends to."""

import http.client
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image

from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[2]
SCANS = 3
CONNECTING = '<span id="state">connecting</span><section id="quality" hidden="">'
LIVE = '<span id="state">live</span><section id="quality">'
BROWSER = f"""#!{sys.executable}
import json, sys, urllib.request
from pathlib import Path
from PIL import Image

*flags, url = sys.argv[1:]
flags = dict(flag.partition("=")[::2] for flag in flags)
seen = Path(__file__).with_name("seen.json")
looks = json.loads(seen.read_text()) if seen.exists() else []
with urllib.request.urlopen(url + "status") as reply:
    scans = json.load(reply)["scans"]["integrated"]
profile = Path(flags["--user-data-dir"])
looks.append({{"url": url, "flags": list(flags), "scans": scans, "fresh": not profile.exists()}})
profile.mkdir(exist_ok=True)
seen.write_text(json.dumps(looks))
size = tuple(map(int, flags["--window-size"].split(",")))
picture = Image.linear_gradient("L").resize(size).convert("RGB")
picture.putpixel((3, 4), (43, 138, 62))
picture.save(flags["--screenshot"])
print({CONNECTING!r} if len(looks) == 1 else {LIVE!r})
"""


@pytest.fixture
def take(tmp_path):
    """Run the script with this program as the only browser there is; None: there is none."""

    def run(program, *flags):
        programs = tmp_path / "programs"
        programs.mkdir()
        if program is not None:
            (programs / "chromium").write_text(program)
            (programs / "chromium").chmod(0o755)
        return subprocess.run(
            [sys.executable, "-m", "docs.page_picture", "--out", tmp_path / "page.png", *map(str, flags)],
            cwd=ROOT,
            env={**without_settings(os.environ), "PATH": str(programs)},
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )

    return run


def test_it_is_taken_of_a_demo_once_the_page_shows_everything(take, tmp_path):
    ended = take(BROWSER, "--scans", SCANS)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")
    looks = json.loads((tmp_path / "programs" / "seen.json").read_text())
    assert len(looks) == 2
    assert all(look["scans"] >= SCANS for look in looks)
    assert looks[0]["fresh"]
    assert {"--headless", "--disable-background-networking", "--no-first-run"} <= set(looks[0]["flags"])
    with Image.open(tmp_path / "page.png") as picture:
        assert (picture.format, picture.mode, picture.size) == ("PNG", "P", (1100, 625))
        pixels = np.asarray(picture.convert("RGB"))
    assert tuple(pixels[4, 3]) == (43, 138, 62)
    address = urlsplit(looks[0]["url"])
    with pytest.raises(ConnectionRefusedError):
        http.client.HTTPConnection(address.hostname, address.port).request("GET", "/")


@pytest.mark.parametrize(
    ("program", "said"),
    [
        (None, r"Chromium is not installed .* apt install chromium"),
        ("#!/bin/sh\necho no display >&2\nexit 3\n", r"\S+/chromium took no picture: no display"),
    ],
)
def test_without_a_picture_it_says_why_in_a_line(take, tmp_path, program, said):
    ended = take(program, "--scans", SCANS)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert re.fullmatch(f"page-picture: (?:{said})\n", ended.stderr)
    assert not (tmp_path / "page.png").exists()


def test_the_picture_that_is_shown_is_small():
    path = ROOT / "docs" / "page.png"
    with Image.open(path) as picture:
        assert picture.size == (1100, 625)
    assert path.stat().st_size < 150_000
