"""What `import ogm_client` offers, and what it must not load."""

import subprocess
import sys

import ogm_client


def test_the_public_names_are_these():
    assert sorted(ogm_client.__all__) == [
        "BadReply",
        "CannotConnect",
        "CannotListen",
        "ClientError",
        "DEFAULT_ADDRESS",
        "MapClient",
        "MapGrid",
        "MapperError",
        "NobodyAnswered",
        "OgmError",
        "Ray",
        "Rays",
        "RecordingWriter",
        "RobotPublisher",
    ]
    assert all(hasattr(ogm_client, name) for name in ogm_client.__all__)
    assert ogm_client.DEFAULT_ADDRESS == "tcp/127.0.0.1:7447"


def test_every_error_of_the_client_is_caught_as_one():
    errors = ["BadReply", "CannotConnect", "CannotListen", "MapperError", "NobodyAnswered"]
    assert all(issubclass(getattr(ogm_client, name), ogm_client.ClientError) for name in errors)
    assert issubclass(ogm_client.ClientError, ogm_client.OgmError)


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
