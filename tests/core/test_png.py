import io

import numpy as np
import pytest
from PIL import Image

from ogm_core.pictures.png import write_png

random = np.random.default_rng(7)


def pictures():
    yield "one pixel", np.array([[200]])
    yield "one row", np.arange(256)[None, :]
    yield "one column", np.arange(256)[:, None]
    yield "wide", random.integers(0, 256, (3, 70_000))
    yield "tall", random.integers(0, 256, (70_000, 3))
    yield "random", random.integers(0, 256, (313, 257))
    yield "constant", np.full((1000, 1000), 205)
    yield "large enough for several deflate blocks", random.choice([0, 205, 254], (2000, 1999))


@pytest.mark.parametrize("grey", [pytest.param(grey, id=name) for name, grey in pictures()])
def test_pillow_reads_back_the_same_picture(grey):
    grey = grey.astype(np.uint8)
    data = write_png(grey)
    with Image.open(io.BytesIO(data)) as picture:
        picture.verify()  # every chunk's CRC
    with Image.open(io.BytesIO(data)) as picture:
        assert (picture.format, picture.mode) == ("PNG", "L")
        assert np.array_equal(np.asarray(picture), grey)


def test_rows_need_not_be_contiguous():
    grey = random.integers(0, 256, (40, 60)).astype(np.uint8)
    assert write_png(grey[::-1, ::2]) == write_png(grey[::-1, ::2].copy())


def test_a_flat_map_is_small():
    assert len(write_png(np.full((2000, 2000), 205, np.uint8))) < 40_000
