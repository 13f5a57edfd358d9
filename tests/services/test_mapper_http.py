"""The map over HTTP: every format, its parameters, headers and errors; pictures are read by Pillow."""

import io
import zlib

import numpy as np
import pytest
import yaml
from PIL import Image

FORMATS = {
    "png": "image/png",
    "json": "application/json",
    "pgm": "image/x-portable-graymap",
    "yaml": "application/yaml",
    "npz": "application/x-npz",
}
FREE_TWICE, FREE_ONCE, HIT_TWICE = 16, 30, 84
GREYS = {"ros": {-1: 205, 30: 205, 16: 254, 84: 0}, "probability": {-1: 127, 30: 77, 16: 40, 84: 215}}


def cross_percent():
    """What `draw_cross` leaves: percent [iy, ix], row 0 south, -1 unknown; cell (-2, -5) is the first."""
    data = np.full((9, 7), -1)
    data[:5, 2] = FREE_ONCE
    data[5, 1:6] = data[6:8, 2] = FREE_TWICE
    data[5, 0] = data[5, 6] = data[8, 2] = HIT_TWICE
    data[5, 2] = -1  # the sensor's own cell
    return data


def greys(percent, palette="ros"):
    """The picture of a map, row 0 north."""
    return np.vectorize(GREYS[palette].get)(percent)[::-1]


def picture(response):
    image = Image.open(io.BytesIO(response.raise_for_status().content))
    assert image.mode == "L"
    return np.asarray(image)


def arrays(response):
    with np.load(io.BytesIO(response.raise_for_status().content)) as archive:
        return dict(archive)


def problem(response, status, slug):
    """The detail of a problem+json answer."""
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["cache-control"] == "no-store"
    body = response.json()
    assert set(body) == {"type", "title", "status", "detail"}
    assert (response.status_code, body["status"], body["type"]) == (status, status, slug)
    assert body["title"] == response.reason_phrase
    return body["detail"]


def test_json(cross):
    reply = cross.http.get("/map.json").json()
    identity = {name: cross.status()[name] for name in ("epoch", "run", "revision", "stamp")}
    assert identity | {"revision": 3, "stamp": 1_700_000_000_000_000_003} == identity
    assert reply == {
        "map": "hall",
        "frame": "map",
        **identity,
        "resolution": 0.5,
        "width": 7,
        "height": 9,
        "origin": {"x": -1.0, "y": -2.5, "theta": 0.0},
        "anchor": [0.0, 0.0],
        "offset": [-2, -5],
        "data": cross_percent().ravel().tolist(),
    }


def test_json_trinary(cross):
    reply = cross.http.get("/map.json?values=trinary").json()
    expected = np.vectorize({-1: -1, FREE_ONCE: -1, FREE_TWICE: 0, HIT_TWICE: 100}.get)(cross_percent())
    assert reply["data"] == expected.ravel().tolist()


@pytest.mark.parametrize("form", ["png", "pgm"])
@pytest.mark.parametrize("palette", [None, "ros", "probability"])
def test_pictures(cross, form, palette):
    response = cross.http.get(f"/map.{form}", params={"palette": palette} if palette else {})
    np.testing.assert_array_equal(picture(response), greys(cross_percent(), palette or "ros"))


def test_npz_says_what_json_says(cross):
    npz = arrays(cross.http.get("/map.npz"))
    log_odds = npz["log_odds"]
    assert log_odds.dtype == np.float32
    probability = 1 / (1 + np.exp(-log_odds.astype(float)))
    known = ~np.isnan(log_odds)
    percent = np.where(known, np.floor(100 * np.where(known, probability, 0) + 0.5), -1)
    np.testing.assert_array_equal(percent, cross_percent())
    np.testing.assert_allclose(log_odds[5, 6], 2 * np.log(0.7 / 0.3), atol=1e-3)
    assert npz["resolution"] == 0.5
    assert npz["origin"].tolist() == [-1.0, -2.5]
    assert npz["offset"].tolist() == [-2, -5]
    assert npz["anchor"].tolist() == [0, 0]


def test_pgm_and_yaml_are_read_as_nav2_reads_them(cross):
    description = yaml.safe_load(cross.http.get("/map.yaml").content)
    assert description.pop("image") == "map.pgm"
    occupied, free = description.pop("occupied_thresh"), description.pop("free_thresh")
    crc32 = zlib.crc32(cross.http.get("/map.pgm").content)
    assert (description.pop("width"), description.pop("height"), description.pop("crc32")) == (7, 9, crc32)
    assert description == {"mode": "trinary", "resolution": 0.5, "origin": [-1.0, -2.5, 0.0], "negate": 0}
    p = (255 - picture(cross.http.get("/map.pgm")).astype(float)) / 255
    read = np.where(p > occupied, 100, np.where(p < free, 0, -1))[::-1]
    assert read.ravel().tolist() == cross.http.get("/map.json?values=trinary").json()["data"]


@pytest.mark.parametrize(
    ("region", "offset", "size"),
    [
        ("-100,-100,100,100", (-2, -5), (7, 9)),
        ("0,0,0.5,0.5", (0, 0), (1, 1)),
        ("0.49,0.1,0.51,0.2", (0, 0), (2, 1)),
        ("-0.001,-0.001,0.5,0.501", (-1, -1), (2, 3)),
        ("2,-2.5,7,-1", (4, -5), (1, 3)),
        ("-1e9,1.4,0.2,1e9", (-2, 2), (3, 2)),
    ],
)
def test_a_region_is_rounded_outward_and_clipped(cross, region, offset, size):
    column, row = offset[0] + 2, offset[1] + 5
    part = cross_percent()[row : row + size[1], column : column + size[0]]
    ask = {"params": {"region": region}}
    reply = cross.http.get("/map.json", **ask)
    assert tuple(reply.json()["offset"]) == offset
    assert (reply.json()["width"], reply.json()["height"]) == size
    assert reply.json()["data"] == part.ravel().tolist()
    x, y = offset[0] * 0.5, offset[1] * 0.5
    assert reply.json()["origin"] == {"x": x, "y": y, "theta": 0.0}
    assert reply.headers["ogm-origin"] == f"{x},{y}"
    np.testing.assert_array_equal(picture(cross.http.get("/map.png", **ask)), greys(part))
    np.testing.assert_array_equal(picture(cross.http.get("/map.pgm", **ask)), greys(part))
    npz = arrays(cross.http.get("/map.npz", **ask))
    assert (npz["log_odds"].shape, npz["offset"].tolist()) == ((size[1], size[0]), list(offset))
    assert yaml.safe_load(cross.http.get("/map.yaml", **ask).content)["origin"] == [x, y, 0.0]


@pytest.mark.parametrize("palette", ["ros", "probability"])
@pytest.mark.parametrize(("max_size", "factor"), [(9, 1), (8, 2), (5, 2), (4, 3), (3, 3), (1, 9), (999, 1)])
def test_a_shrunk_picture_is_made_of_whole_blocks_from_the_lower_left(cross, palette, max_size, factor):
    response = cross.http.get("/map.png", params={"max_size": max_size, "palette": palette})
    percent = cross_percent()
    blocks = np.array(
        [
            [block(percent[i : i + factor, j : j + factor]) for j in range(0, 7, factor)]
            for i in range(0, 9, factor)
        ]
    )
    np.testing.assert_array_equal(picture(response), greys(blocks, palette))
    assert float(response.headers["ogm-resolution"]) == 0.5 * factor
    assert response.headers["ogm-origin"] == "-1.0,-2.5"


def block(percent):
    """Occupied wins, then free: the highest p if that is occupied, else the lowest known."""
    known = percent[percent >= 0]
    if not known.size:
        return -1
    return known.max() if known.max() > 65 else known.min()


BAD_REGIONS = ["1,1,0,0", "0,1,1,0", "0,0,0,1", "nan,0,1,1", "0,0,inf,1", "-inf,0,1,1", "100,100,101,101"]
BAD_REGIONS += ["3,0,4,1", "0,0,1", "0,0,1,1,1", "a,b,c,d", "", "0;0;1;1", "0,0,1_0,1", "0,0,0x1,1"]
BAD_REGIONS += ["0,0,%D9%A1,1"]
ANYWHERE = [f"region={region}" for region in BAD_REGIONS] + ["regoin=0,0,1,1", "x=1", "=1", "region", "stamp"]
ANYWHERE += ["region=0,0,1,1&region=0,0,1,1", "format=png"]
MAX_SIZES = ["0", "-1", "1.5", "", "many", "9999999999", "%C2%B2", "1e3"]
BAD = [(form, query) for form in FORMATS for query in ANYWHERE]
BAD += [("png", f"max_size={size}") for size in MAX_SIZES]
BAD += [(form, "max_size=5") for form in FORMATS if form != "png"]
BAD += [(form, "palette=ros") for form in ("json", "yaml", "npz")]
BAD += [(form, f"palette={name}") for form in ("png", "pgm") for name in ("", "ROS", "trinary", "values")]
BAD += [("json", f"values={name}") for name in ("", "ros", "probability")]
BAD += [(form, "values=trinary") for form in FORMATS if form != "json"]


def test_a_bad_parameter_is_400_and_named(cross):
    for form, query in BAD:
        detail = problem(cross.http.get(f"/map.{form}?{query}"), 400, "bad-parameter")
        assert query.partition("=")[0] in detail, (form, query)


def test_every_map_carries_its_identity(cross):
    status = cross.status()
    for form, media_type in FORMATS.items():
        response = cross.http.get(f"/map.{form}")
        headers = response.headers
        assert headers["content-type"].partition(";")[0] == media_type
        assert headers["cache-control"] == "no-cache"
        assert headers["etag"] == f'"{status["epoch"]}-{status["run"]}-3"'
        named = {name: value for name, value in headers.items() if name.startswith("ogm-")}
        assert named == {
            "ogm-resolution": "0.5",
            "ogm-origin": "-1.0,-2.5",
            "ogm-epoch": status["epoch"],
            "ogm-run": status["run"],
            "ogm-revision": "3",
            "ogm-stamp": str(status["stamp"]),
        }


def test_head_has_the_headers_of_get_and_no_body(cross):
    for path in [f"/map.{form}" for form in FORMATS] + ["/status", "/quality", "/version", "/livez", "/"]:
        head, get = cross.http.head(path), cross.http.get(path)
        assert (head.status_code, head.content) == (200, b"")
        # A status is longer or shorter by a few digits, so maybe worth compressing at one time only.
        differ = {"date", "content-length", "content-encoding"} if path == "/status" else {"date"}
        assert {k: v for k, v in head.headers.items() if k not in differ} == {
            k: v for k, v in get.headers.items() if k not in differ
        }
    assert cross.http.head("/map.png?no=1").status_code == 400
    assert cross.http.head("/nothing").status_code == 404


def test_an_empty_map(mapper):
    for form in ("png", "pgm", "yaml"):
        problem(mapper.http.get(f"/map.{form}"), 404, "map-empty")
    reply = mapper.http.get("/map.json")
    body = reply.json()
    assert (body["width"], body["height"], body["data"], body["stamp"], body["revision"]) == (
        0,
        0,
        [],
        None,
        0,
    )
    assert (reply.headers["ogm-stamp"], reply.headers["ogm-revision"]) == ("null", "0")
    assert arrays(mapper.http.get("/map.npz"))["log_odds"].shape == (0, 0)
    assert mapper.http.get("/map.json?region=0,0,1,1").json()["data"] == []
    problem(mapper.http.get("/map.json?region=1,1,0,0"), 400, "bad-parameter")
    problem(mapper.http.get("/map.png?palette=no"), 400, "bad-parameter")
    assert mapper.status()["map_info"] == {
        "known_cells": 0,
        "bytes": 0,
        "width": 0,
        "height": 0,
        "resolution": 0.5,
    }


def test_a_bounded_map_is_served_whole(start_mapper):
    bounds = {"resolution": 0.1, "bounds": [-1.0, -2.0, 3.0, 1.0]}
    with start_mapper(map=bounds) as mapper:
        reply = mapper.http.get("/map.json").json()
        assert (reply["width"], reply["height"], reply["offset"]) == (40, 30, [0, 0])
        assert (reply["anchor"], set(reply["data"])) == ([-1.0, -2.0], {-1})
        assert (picture(mapper.http.get("/map.png")) == 205).all()
