"""The page with Leaflet that docs/viewers.md gives shows the map, cell for cell, in a real browser."""

import io
import math
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

VIEWERS = Path(__file__).parents[2] / "docs" / "viewers.md"
WIDTH, HEIGHT = 800, 600
LEAFLETS_GROUND = 0xDD
"""Its grey, red, green and blue."""


@pytest.fixture(scope="module")
def chromium():
    found = shutil.which("chromium") or shutil.which("chromium-browser")
    if found is None:
        reason = "pages are looked at in Chromium, which is not installed: apt-get install chromium"
        (pytest.fail if os.environ.get("OGM_WEB_TESTS") == "require" else pytest.skip)(reason)
    return found


def page_of(section):
    """The page that a section of the documentation gives."""
    return re.search(rf"^## {section}$.*?^```html\n(.*?)^```", VIEWERS.read_text(), re.DOTALL | re.M)[1]


def replaced(text, old, new):
    assert old in text
    return text.replace(old, new)


def draw_star(mapper):
    """A scan of an uneven room, seen twice, so that some cells are occupied, some free, and most unknown."""
    ranges = 4.0 + 3.0 * np.sin(np.arange(720) * 0.13)
    for at in (1, 2):
        mapper.scan(ranges, at=at, pose=[0.3, -0.2, 0.0], angle_increment=math.tau / 720)
    mapper.settle(received=2)


def test_the_page_with_leaflet_shows_every_known_cell_in_its_place(start_mapper, chromium, tmp_path):
    leaflet = Path(pytest.importorskip("js_lib_leaflet").__file__).parent / "static" / "js_lib_leaflet"
    with start_mapper() as mapper:
        draw_star(mapper)
        page = replaced(page_of("Leaflet"), "http://127.0.0.1:8000", str(mapper.http.base_url).rstrip("/"))
        page = replaced(page, "https://unpkg.com/leaflet@1.9.4/dist", leaflet.as_uri())
        # A window is smaller inside than it is said to be.
        size = f"body {{ margin: 0 }} #map {{ width: {WIDTH}px; height: {HEIGHT}px;"
        (tmp_path / "page.html").write_text(replaced(page, "html, body, #map { height: 100%;", size))
        shown = screenshot(chromium, tmp_path)
        asked = {"palette": "cividis", "transparent": "1"}
        picture = mapper.http.get("/map.png", params=asked).raise_for_status().content
        ix, iy = mapper.http.get("/map.json").json()["offset"]
    cells = np.asarray(Image.open(io.BytesIO(picture)).convert("RGBA"))
    top, left = HEIGHT // 2 - (iy + cells.shape[0]), WIDTH // 2 + ix
    part = shown[top : top + cells.shape[0], left : left + cells.shape[1]]
    known = cells[..., 3] == 255
    assert 1000 < known.sum() < known.size - 1000
    np.testing.assert_array_equal(part[known], cells[known][:, :3])
    assert (part[~known] == LEAFLETS_GROUND).all()


def screenshot(chromium, folder):
    """What the browser shows of page.html, [row, column, colour]."""
    command = [
        *(chromium, "--headless", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars"),
        *(f"--user-data-dir={folder / 'profile'}", f"--window-size={WIDTH + 100},{HEIGHT + 300}"),
        *("--virtual-time-budget=3000", f"--screenshot={folder / 'page.png'}"),
        (folder / "page.html").as_uri(),
    ]
    subprocess.run(command, check=True, capture_output=True, timeout=120)
    return np.asarray(Image.open(folder / "page.png").convert("RGB"))
