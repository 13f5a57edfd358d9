"""Clients that others' programs generate from /openapi.json: they type-check, and get what they ask for."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from described_http import document

ROOT = Path(__file__).parents[2]
PROGRAMS = ROOT / "tests" / "generated"
MADE = ROOT / "build" / "clients"
ENDED = 300.0
"""How long a program may take on a busy machine, s."""


def run(*command, **options):
    """What a program says; it has to end well."""
    options = {"capture_output": True, "text": True, "timeout": ENDED} | options
    done = subprocess.run([str(part) for part in command], check=False, **options)
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture
def sources(tmp_path):
    """A folder with the document, and nothing else."""
    (tmp_path / "openapi.json").write_text(json.dumps(document()), encoding="utf-8")
    return tmp_path


@pytest.fixture
def drawn(start_mapper):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        mapper.draw_cross()
        yield mapper


def test_a_client_in_python(drawn, sources):
    pytest.importorskip("openapi_python_client", reason="`make test-clients` installs it")
    generator, mypy = (Path(sys.executable).with_name(name) for name in ("openapi-python-client", "mypy"))
    config = ROOT / "examples" / "openapi-python-client.yml"
    said = run(
        *(generator, "generate", "--path", sources / "openapi.json", "--meta", "none", "--config", config),
        *("--output-path", sources / "ogm_http", "--fail-on-warning"),
    )
    assert "WARNING" not in said
    shutil.copy(PROGRAMS / "look.py", sources)
    run(mypy, "--strict", "--cache-dir", sources / "cache", "ogm_http", "look.py", cwd=sources)
    url = str(drawn.http.base_url).rstrip("/")
    told = json.loads(run(sys.executable, "look.py", url, "map.png", "map.npz", cwd=sources))
    probability = told["cell"].pop()
    assert 0.8 < probability < 0.9
    assert told == {
        "status": ["hall", 3, 3, 0.5],
        "map": [7, 9, -1.0, -2.5, 3 * 100 + (7 * 9 - 14) + 5],
        "cell": [4, 0, True],
        "rays": [[1.75, 1.25], ["hit", "hit"]],
        "check": ["free", "occupied"],
        "again": 304,
        "refused": [400, "bad-parameter", "n: 1 to 10000 is needed, got 0"],
        "erased": [4, 1],
    }
    with Image.open(sources / "map.png") as picture:
        assert (picture.size, picture.mode) == ((4, 4), "P")
    with np.load(sources / "map.npz") as arrays:
        assert arrays["log_odds"].shape == (9, 7)


def test_a_client_in_typescript(drawn, sources):
    if not (MADE / "npm.made").exists():
        reason = MADE / "npm.missing"
        pytest.skip(f"npm: {reason.read_text().strip() if reason.exists() else 'run make test-clients'}")
    # The programs are others': they see nothing of this environment.
    others = {"env": {"PATH": os.environ["PATH"], "HOME": str(MADE / "home")}, "cwd": sources}
    packages = MADE / "npm" / "node_modules"
    (sources / "node_modules").symlink_to(packages)
    (sources / "package.json").write_text('{"type": "module"}', encoding="utf-8")
    shutil.copy(PROGRAMS / "look.ts", sources)
    run("node", packages / "openapi-typescript/bin/cli.js", "openapi.json", "-o", "mapper.d.ts", **others)
    options = ["--strict", "--exactOptionalPropertyTypes", "--target", "es2022", "--module", "es2022"]
    options += ["--moduleResolution", "bundler", "--lib", "es2022,dom"]
    run("node", packages / "typescript/bin/tsc", *options, "look.ts", **others)
    told = json.loads(run("node", "look.js", str(drawn.http.base_url).rstrip("/"), **others))
    assert told == {
        "status": ["hall", 3, 0],
        "map": [4, 4, [-1.0, -1.0], 4],
        "cell": [4, 0, True],
        "rays": [[1.75], ["hit"]],
        "tile": [200, True],
        "refused": [400, "bad-parameter"],
    }
