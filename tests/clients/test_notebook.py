"""What a notebook shows of a map: the picture in the page, its scale bar, its caption."""

import base64
import io
import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from ogm_client import MapGrid
from ogm_core.pictures.scale_bar import round_length

SVG = "{http://www.w3.org/2000/svg}"


def grid_of(height, width, resolution=0.05):
    """Free, with an occupied cell in the south-west corner and an unknown one in the north-east."""
    log_odds = np.full((height, width), -2.0, np.float32)
    log_odds[0, 0], log_odds[-1, -1] = 2.0, math.nan
    return MapGrid(log_odds, resolution, (0.0, 0.0), (-40, 3), epoch="e", revision=12, stamp=None)


class Shown:
    """The parts of what a grid shows itself as, which is well-formed and loads nothing."""

    def __init__(self, grid):
        html = grid._repr_html_()
        assert not re.search(r"(?<!data:image/png;)(src|url)\W|https?://(?!www.w3.org/2000/svg)", html)
        root = ElementTree.fromstring(html)
        self.svg = root.find(f"{SVG}svg")
        self.size = int(self.svg.get("width")), int(self.svg.get("height"))
        assert self.svg.get("viewBox") == f"0 0 {self.size[0]} {self.size[1]}"
        self.image = self.svg.find(f"{SVG}image")
        self.drawn = int(self.image.get("width")), int(self.image.get("height"))
        head, _, data = self.image.get("href").partition(",")
        assert head == "data:image/png;base64"
        with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as picture:
            self.pixels = np.asarray(picture)
        self.bar = float(re.search(r"h([\d.]+)", self.svg.find(f"{SVG}path").get("d"))[1])
        self.label = self.svg.find(f"{SVG}text").text
        self.caption = root.find("div").text


def test_a_picture_with_scale_bar_and_caption():
    shown = Shown(grid_of(100, 160))
    assert (shown.pixels.shape, shown.drawn) == ((100, 160), (480, 300))  # three times as large
    assert (shown.pixels[-1, 0], shown.pixels[0, -1], shown.pixels[50, 50]) == (0, 205, 254)
    assert "pixelated" in shown.image.get("style")
    assert shown.label == "2 m"
    assert shown.bar == 2 / 0.05 * 3
    assert shown.size[0] == 480 > shown.bar
    assert shown.size[1] > 300
    assert shown.caption == (
        "MapGrid, 160 × 100 cells of 0.05 m = 8 × 5 m, lower-left corner (-2, 0.15), revision 12"
    )


def test_a_large_map_is_shrunk():
    shown = Shown(grid_of(100, 2500, 0.1))
    assert (shown.pixels.shape, shown.drawn) == ((25, 625), (625, 25))
    assert (shown.pixels[-1, 0], shown.pixels[0, 1]) == (0, 254)  # occupied wins
    assert (shown.label, shown.bar) == ("50 m", 50 / 0.1 / 4)
    assert "2500 × 100 cells of 0.1 m = 250 × 10 m" in shown.caption


@pytest.mark.parametrize(
    ("height", "width", "drawn"),
    [(2, 4, (480, 240)), (300, 2, (2, 300)), (1, 2, (480, 240)), (1, 1, (480, 480))],
)
def test_a_tiny_map_is_enlarged_and_its_label_stays_in_the_picture(height, width, drawn):
    shown = Shown(grid_of(height, width))
    assert shown.drawn == drawn
    assert shown.pixels.shape == (height, width)
    text = shown.svg.find(f"{SVG}text")
    assert float(text.get("x")) + 7 * len(shown.label) < shown.size[0]


@pytest.mark.parametrize("width", [1, 3, 7, 11, 40, 99, 160, 777, 1234, 90_000])
@pytest.mark.parametrize("resolution", [0.001, 0.05, 0.3, 1e3])
def test_a_scale_bar_is_a_round_number_about_a_fifth_of_the_width(width, resolution):
    shown = Shown(grid_of(1, width, resolution))
    length, unit = shown.label.split()
    assert unit == "m"
    assert re.fullmatch(r"[125]0*(e\+\d+)?|0\.0*[125]|[125]e-\d+", length)
    assert 0.12 < float(length) / (width * resolution) < 0.32
    factor = math.ceil(width / 800)
    zoom = shown.drawn[0] / math.ceil(width / factor)
    assert shown.bar == pytest.approx(float(length) / resolution / factor * zoom, rel=1e-5)


@pytest.mark.parametrize(
    ("length", "rounded"),
    [(1.0, 1), (1.41, 1), (1.42, 2), (3.1, 2), (3.2, 5), (7, 5), (7.1, 10), (99, 100), (0.06, 0.05)],
)
def test_a_length_is_rounded_by_ratio(length, rounded):
    assert round_length(length) == rounded


def test_an_empty_map_says_so():
    grid = MapGrid(np.empty((0, 0)), 0.05, (0.0, 0.0), (0, 0), epoch="e", revision=0, stamp=None)
    html = grid._repr_html_()
    assert "no known cell yet" in html
    assert "<svg" not in html
