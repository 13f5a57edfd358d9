import io
import re

import numpy as np
import pytest
import yaml
from PIL import Image

from ogm_core.files.ros_map_writer import write_pgm, write_yaml

CORE_SCHEMA_FLOAT = re.compile(r"-?(0|[1-9][0-9]*)\.[0-9]+(e[-+][0-9]+)?")
"""What PyYAML (YAML 1.1), yaml-cpp (a C++ stream) and YAML 1.2 all take for a float."""

NUMBERS = [
    0.05,
    0.1 + 0.2,
    1e-05,
    -1e-17,
    1.2345678901234567e-05,
    5e-324,
    1e16,
    1e22,
    -1.5e300,
    -0.0,
    0.0,
    123456789.12345679,
    3,
    np.float64(0.025),
]


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (211, 107)])
def test_pillow_reads_the_pgm(shape):
    grey = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    data = write_pgm(grey[::-1])
    assert data.startswith(b"P5\n%d %d\n255\n" % (shape[1], shape[0]))
    with Image.open(io.BytesIO(data)) as picture:
        assert picture.mode == "L"
        assert np.array_equal(np.asarray(picture), grey[::-1])


def test_yaml_is_what_map_server_asks_for():
    assert yaml.safe_load(write_yaml("map.pgm", 0.05, (-1.25, 3.0))) == {
        "image": "map.pgm",
        "mode": "trinary",
        "resolution": 0.05,
        "origin": [-1.25, 3.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }


@pytest.mark.parametrize("number", NUMBERS)
def test_numbers_are_exact_floats_in_every_yaml(number):
    text = write_yaml("map.pgm", number, (number, -number))
    read = yaml.safe_load(text)
    got = [read["resolution"], *read["origin"]]
    assert [type(value) for value in got] == [float] * 4
    assert [value.hex() for value in got] == [float(v).hex() for v in (number, number, -number, 0.0)]
    written = re.search(r"resolution: (\S+)\norigin: \[(\S+), (\S+), (\S+)\]\n", text).groups()
    for token, value in zip(written, got, strict=True):
        assert CORE_SCHEMA_FLOAT.fullmatch(token)
        assert float(token) == value


@pytest.mark.parametrize(
    "name", ["map.pgm", "123", "null", "a: b #c.pgm", 'quo"te\\.pgm', "Büro 東.pgm", "no"]
)
def test_any_file_name_survives(name):
    assert yaml.safe_load(write_yaml(name, 0.05, (0.0, 0.0)))["image"] == name
