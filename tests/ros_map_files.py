"""Map files in nav2's format, as tests want them: right in all but what each test changes."""

import io

import numpy as np
import pytest
from PIL import Image

from ogm_core.errors import BadMapFile
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.files.ros_map_writer import write_pgm

EVERY_GREY = np.arange(256, dtype=np.uint8).reshape(8, 32)


PGM = write_pgm(EVERY_GREY)


FIELDS = {
    "image": "map.pgm",
    "mode": "trinary",
    "resolution": "0.05",
    "origin": "[-1.5, 2.25, 0.0]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.196",
}


def png(array, mode=None, **options):
    file = io.BytesIO()
    Image.fromarray(array, mode).save(file, "PNG", **options)
    return file.getvalue()


def refusal(path):
    """The text of the refusal, which names the file, in one line."""
    with pytest.raises(BadMapFile) as caught:
        read_ros_map(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    assert len(text) < 600 + len(str(path))
    return text.removeprefix(f"{path}: ")


def write_ros_map(folder, picture=PGM, **changes):
    """Write map.yaml, with `changes` of its fields (None: left out), and map.pgm; the former's path."""
    fields = {key: value for key, value in {**FIELDS, **changes}.items() if value is not None}
    path = folder / "map.yaml"
    path.write_text("".join(f"{key}: {value}\n" for key, value in fields.items()), encoding="utf-8")
    if picture is not None:
        (folder / "map.pgm").write_bytes(picture)
    return path
