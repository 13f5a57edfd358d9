"""docker/Dockerfile: what its commands make is a complete wheel, an install, and an image that works."""

import http.server
import json
import re
import socket
import threading
import tomllib
import zipfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from ogm_services.settings.sources import load_settings

ROOT = Path(__file__).parents[2]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
PACKAGES = {"ogm_core": ROOT, "ogm_services": ROOT / "services", "ogm_client": ROOT / "clients"}
FILES = {"map.png", "map.pgm", "map.yaml", "map.npz", "quality.json"}
CACHE = "/var/cache/ogm"
DATA = "/var/lib/ogm"
PORT = "8000"
STARTED = 120.0


def the(stage, name):
    """The one instruction of that name."""
    (found,) = (instruction for instruction in stage if instruction.name == name)
    return found


@pytest.fixture(scope="module")
def wheel(image):
    (path,) = (image.root / "wheels").iterdir()
    with zipfile.ZipFile(path) as archive:
        return path.name, archive.namelist()


@pytest.fixture
def health(dockerfile, image):
    """`health(port)`: exit code of the health check, asked at another port than the image's."""
    *words, code = json.loads(the(dockerfile[-1], "HEALTHCHECK").text.removeprefix("CMD "))
    assert PORT in code
    return lambda port: image.run([*words, code.replace(PORT, str(port))]).returncode


@contextmanager
def answering(status):
    """A server that answers everything so; its port."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(status if self.path == "/readyz" else 404)
            self.end_headers()

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


def test_the_wheel_holds_the_three_packages_with_all_their_files_and_nothing_else(wheel):
    name, files = wheel
    assert name == f"zenoh_ogm-{PROJECT['version']}-py3-none-any.whl"
    info = f"zenoh_ogm-{PROJECT['version']}.dist-info"
    assert {file.split("/")[0] for file in files} == {*PACKAGES, info}
    expected = {
        str(path.relative_to(parent))
        for package, parent in PACKAGES.items()
        for path in (parent / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {file for file in files if not file.startswith(info)} == expected
    assert expected > {f"{package}/py.typed" for package in PACKAGES}
    page = "ogm_services/mapper/serving/page"
    assert {f"{page}/index.html", f"{page}/page.css", f"{page}/main.js"} < expected
    assert f"{info}/licenses/LICENSE" in files
    # A whole checkout, which Docker is not sent, gives the same wheel: nothing else is named.
    named = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    folders = [str((parent / package).relative_to(ROOT)) for package, parent in PACKAGES.items()]
    assert named == {"packages": folders}


def test_the_program_comes_from_the_install_and_knows_its_version(image):
    version = image.run(["ogm", "--version"], check=True)
    assert version.stdout == f"ogm {PROJECT['version']}\n"
    for package in PACKAGES:
        where = f"import {package}; print({package}.__file__)"
        path = Path(image.run(["python", "-c", where], check=True).stdout)
        assert path.is_relative_to(image.root / "opt/ogm"), path


def test_a_log_is_recorded_and_mapped(image, tmp_path):
    log, out = tmp_path / "log.jsonl.gz", tmp_path / "map"
    image.run(["ogm", "simulate", "--world", "office", "--scans", "4", "--out", log], check=True)
    built = image.run(["ogm", "build", log, "--out", out], check=True)
    assert (built.stdout, built.stderr) == (f"{out}: 4 scans read, 4 integrated\n", "")
    assert {path.name for path in out.iterdir()} == FILES


def test_a_mapper_is_healthy_once_ready_and_writes_nothing_but_to_its_volume(
    dockerfile, image, services, health, eventually, tmp_path
):
    volume = image.root / CACHE[1:]

    def files():
        return {path: path.stat().st_mtime_ns for path in image.root.rglob("*") if path.is_file()}

    before = files()
    assert [path for path in before if path.is_relative_to(volume) and path.suffix == ".nbc"]
    assert list((image.root / "tmp").iterdir()) == []
    command = [*the(dockerfile[-1], "ENTRYPOINT").words, "mapper", "--listen", "tcp/127.0.0.1:0"]
    log = services("mapper", [*command, "--http-port", "0"], cwd="/", env=image.environ)
    port = int(eventually(lambda: re.search(r"live map http://.*:(\d+)/", log.read_text()), STARTED)[1])
    assert health(port) == 0
    # Every address of the container is served, such as this one: -p does not lead to its 127.0.0.1.
    with socket.create_connection(("127.0.0.2", port), timeout=5):
        pass
    after = files()
    assert before.items() <= after.items()  # what is in the volume from the start is used, not compiled again
    assert [path for path in after if path not in before and not path.is_relative_to(volume)] == []


def test_the_health_check_fails_where_nobody_is_or_is_ready(health):
    with answering(200) as port:
        assert health(port) == 0
    assert health(port) == 1
    with answering(503) as port:
        assert health(port) == 1


def test_the_image_runs_without_privileges_on_ports_and_volumes_that_it_names(dockerfile):
    last = dockerfile[-1]
    user, group = the(last, "USER").text.split(":")
    made = next(instruction.text for instruction in last if "useradd" in instruction.text)
    assert f"--uid {user} --gid {group} " in made
    assert f"chown {user}:{group} {CACHE} {DATA}" in made
    assert int(user) > 1000
    names = [instruction.name for instruction in last]
    assert names.index("USER") < names.index("RUN", names.index("USER")) < names.index("VOLUME")
    environ = dict(word.split("=") for word in the(last, "ENV").words)
    assert the(last, "VOLUME").words == [CACHE, DATA]
    assert environ["NUMBA_CACHE_DIR"] == CACHE
    assert environ["OGM_HTTP__HOST"] == "0.0.0.0"
    settings = load_settings(config=None, flags={}, environ=environ)
    assert (settings.http.host, str(settings.http.port)) == ("0.0.0.0", PORT)
    assert settings.network.for_mapper().listen == ("tcp/127.0.0.1:7447",)
    assert the(last, "EXPOSE").words == [PORT, "7447"]
    assert (the(last, "ENTRYPOINT").words, the(last, "STOPSIGNAL").text) == (["ogm"], "SIGTERM")


def test_both_stages_start_from_one_slim_python_that_the_project_supports(dockerfile):
    images = {the(stage, "FROM").text.split()[0] for stage in dockerfile}
    ((name, version),) = (re.fullmatch(r"(\w+):3\.(\d+)-slim", image).groups() for image in images)
    oldest = re.fullmatch(r">=3\.(\d+)", PROJECT["requires-python"])[1]
    assert (name, int(version) >= int(oldest)) == ("python", True)


def test_what_is_copied_into_the_image_is_all_that_docker_is_sent(dockerfile):
    lines = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if not line.startswith("#")]
    assert (lines[0], lines[-1]) == ("*", "**/__pycache__")
    copied = {
        source
        for stage in dockerfile
        for instruction in stage
        if instruction.name == "COPY" and "from" not in instruction.flags
        for source in instruction.words[:-1]
    }
    assert set(lines[1:-1]) == {f"!{source}" for source in copied}
