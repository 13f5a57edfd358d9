"""What `import ogm_client` offers, and what it must not load."""

import builtins
import inspect
import re
import subprocess
import sys
import typing

import pytest
from numpy.typing import ArrayLike

import ogm_client


def test_the_public_names_are_these():
    assert sorted(ogm_client.__all__) == [
        "AsyncMapClient",
        "AsyncMapFollower",
        "BadInput",
        "BadMapFile",
        "BadMessage",
        "BadParameter",
        "BadRecording",
        "BadReply",
        "BadSetting",
        "CannotConnect",
        "CannotListen",
        "Change",
        "ClientError",
        "DEFAULT_ADDRESS",
        "DiskFull",
        "MapClient",
        "MapEmpty",
        "MapFollower",
        "MapGrid",
        "MapLayer",
        "MapperError",
        "MissingExtra",
        "MissingShare",
        "NobodyAnswered",
        "NotHeard",
        "OgmError",
        "PartialMap",
        "Ray",
        "Rays",
        "RecordingWriter",
        "RobotPublisher",
        "RobotStatus",
        "SnapshotInfo",
        "SourceStatus",
        "Status",
    ]
    assert all(hasattr(ogm_client, name) for name in ogm_client.__all__)
    assert ogm_client.DEFAULT_ADDRESS == "tcp/127.0.0.1:7447"


def test_every_error_of_the_client_is_caught_as_one():
    errors = ["BadReply", "CannotConnect", "CannotListen", "MapperError", "NobodyAnswered", "NotHeard"]
    assert all(issubclass(getattr(ogm_client, name), ogm_client.ClientError) for name in errors)
    assert issubclass(ogm_client.ClientError, ogm_client.OgmError)


PUBLIC = [
    member
    for name in ogm_client.__all__
    if isinstance(kind := getattr(ogm_client, name), type) and not issubclass(kind, Exception)
    for member in [kind, *vars(kind).values()]
]


def test_every_error_that_is_spoken_of_is_importable():
    spoken_of = {
        name
        for member in PUBLIC
        for text in [inspect.getdoc(getattr(member, "__func__", member)) or ""]
        for name in re.findall(r"^    (\w+(?:, \w+)*): ", text.partition("Raises:\n")[2], re.MULTILINE)
    }
    assert {"BadMessage", "BadSetting", "CannotConnect", "ClientError", "MapEmpty"} <= spoken_of
    assert spoken_of <= {*ogm_client.__all__, *dir(builtins)}


@pytest.mark.parametrize(
    ("function", "name"),
    [
        (ogm_client.RobotPublisher.publish_scan, "ranges"),
        (ogm_client.RobotPublisher.publish_scan, "mount"),
        (ogm_client.RobotPublisher.publish_scan, "pose"),
        (ogm_client.RecordingWriter.write_scan, "mount"),
        (ogm_client.RecordingWriter.write_scan, "pose"),
        (ogm_client.MapClient.get_map, "region"),
        (ogm_client.MapClient.fetch, "parameters"),
        (ogm_client.MapGrid.crop, "region"),
    ],
)
def test_whatever_makes_an_array_is_typed_as_such(function, name):
    kinds = typing.get_args(typing.get_type_hints(function)[name])
    assert set(typing.get_args(ArrayLike)) <= set(kinds)


def test_importing_and_using_it_is_light(tmp_path):
    heavy = {"numba", "llvmlite", "fastapi", "uvicorn", "typer", "pydantic", "matplotlib", "scipy", "orjson"}
    use = "grid.raycast(0.0, 0.0, 0.0), grid.crop((0, 0, 1, 1)), grid._repr_html_()"
    program = (
        "import sys, numpy, ogm_client\n"
        "grid = ogm_client.MapGrid(numpy.ones((2, 2)), 1.0, (0.0, 0.0), (0, 0), 'e', 1, None)\n"
        f"{use}\n"
        "with ogm_client.RecordingWriter(sys.argv[1]) as recording: recording.write_pose(0.0, 0.0, 0.0)\n"
        f"print({heavy} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "log.jsonl.gz")],
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    assert done.stdout == "set()\n"
