"""clients/pyproject.toml: what zenoh-ogm-client holds, that a robot needs no more, that it stays alone."""

import email
import importlib.metadata
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import grimp
import pytest

from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[2]
CLIENTS = ROOT / "clients"
WHOLE = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
VERSION = WHOLE["version"]
NAME = f"zenoh_ogm_client-{VERSION}"
README = (CLIENTS / "README.md").read_text()
LARGEST = 130e6
"""What the client and all that it needs may take, bytes."""
STEP = 300.0
"""How long pip may take, s: it downloads a hundred megabytes if it has none of them."""
STARTED = 120.0


@dataclass(frozen=True)
class Environment:
    """A virtual environment, empty at first: without pip too, which works on it from outside."""

    root: Path

    @classmethod
    def empty(cls, folder):
        venv.create(folder, symlinks=True)
        return cls(folder)

    @property
    def python(self):
        return self.root / "bin/python"

    @property
    def site(self):
        (found,) = self.root.glob("lib/python*/site-packages")
        return found

    def run(self, *words, cwd=None, check=True):
        """Run a program with nothing but this environment to import from."""
        environ = without_settings(os.environ)
        for name in ("VIRTUAL_ENV", "PYTHONPATH"):
            environ.pop(name, None)
        ended = subprocess.run(
            [*map(str, words)],
            cwd=cwd or self.root,
            env=environ,
            capture_output=True,
            text=True,
            timeout=STEP,
            check=False,
        )
        assert not check or ended.returncode == 0, f"{words}\n{ended.stdout}{ended.stderr}"
        return ended

    def pip(self, *words):
        outside = sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet"
        return self.run(*outside, "--python", self.python, *words)

    def files(self):
        """What is installed, relative to `site`, but for what Python has compiled."""
        there = {path.relative_to(self.site) for path in self.site.rglob("*") if path.is_file()}
        return {str(path) for path in there if "__pycache__" not in path.parts}


@dataclass(frozen=True)
class Built:
    """The two wheels, and the client's source distribution with the wheel that pip makes of it."""

    client: Path
    whole: Path
    sdist: Path
    of_sdist: Path


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    folder = tmp_path_factory.mktemp("built")
    builder = Environment.empty(folder / "builder")
    builder.pip("install", "hatchling")
    builder.pip("wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT, CLIENTS)
    builder.run(builder.python, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=CLIENTS)
    sdist = folder / f"{NAME}.tar.gz"
    builder.pip("wheel", "--no-deps", "--wheel-dir", folder / "of_sdist", sdist)
    wheel = f"{NAME}-py3-none-any.whl"
    whole = folder / f"zenoh_ogm-{VERSION}-py3-none-any.whl"
    return Built(folder / wheel, whole, sdist, folder / "of_sdist" / wheel)


@pytest.fixture(scope="module")
def robot(built, tmp_path_factory):
    """An environment with the client and what it needs, from the package index, and nothing else."""
    robot = Environment.empty(tmp_path_factory.mktemp("robot"))
    robot.pip("install", built.client)
    return robot


@pytest.fixture(scope="module")
def reached():
    """Names of all modules outside of ogm_client that it imports, directly or not."""
    graph = grimp.build_graph("ogm_client", "ogm_core", include_external_packages=True, cache_dir=None)
    return graph.find_upstream_modules("ogm_client", as_package=True)


def names_in(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if not name.startswith(f"{NAME}.dist-info/")}


def metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return email.message_from_bytes(archive.read(f"{NAME}.dist-info/METADATA"))


def source_of(module):
    path = ROOT.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def test_the_wheel_holds_ogm_client_and_what_it_reaches_of_the_core_and_nothing_else(built, reached):
    core = {module for module in reached if module.split(".")[0] == "ogm_core"}
    core |= {module.rpartition(".")[0] for module in core} - {""}
    assert {"ogm_core.wire.messages", "ogm_core.snapshot", "ogm_core.pictures.png"} < core
    expected = {str(source_of(module).relative_to(ROOT)) for module in core} | {"ogm_core/py.typed"}
    mine = (path for path in (CLIENTS / "ogm_client").rglob("*") if path.is_file())
    expected |= {str(path.relative_to(CLIENTS)) for path in mine if "__pycache__" not in path.parts}
    assert names_in(built.client) == expected
    assert expected < names_in(built.whole)
    with zipfile.ZipFile(built.client) as client, zipfile.ZipFile(built.whole) as whole:
        assert all(client.read(name) == whole.read(name) for name in expected)


def test_a_source_distribution_gives_the_same_wheel(built):
    with tarfile.open(built.sdist) as archive:
        names = {name.removeprefix(f"{NAME}/") for name in archive.getnames()}
    own = {"pyproject.toml", "hatch_build.py", "README.md", "LICENSE", "PKG-INFO"}
    assert names - {".gitignore"} == names_in(built.client) | own
    assert built.of_sdist.read_bytes() == built.client.read_bytes()


def test_it_states_what_it_imports_as_the_whole_project_states_it(built, reached):
    third = {module.split(".")[0] for module in reached} - {"ogm_core", *sys.stdlib_module_names}
    homes = importlib.metadata.packages_distributions()
    imported = {home for module in third for home in homes[module]}
    assert {"numpy", "eclipse-zenoh"} < imported
    needed = metadata(built.client).get_all("Requires-Dist")
    assert {re.match(r"[\w-]+", need)[0] for need in needed} == imported
    # SciPy is loaded only by who asks for distances, matplotlib by who plots: extras.
    assert [need for need in needed if "extra" in need] == [
        "scipy>=1.14; extra == 'distance'",
        "matplotlib>=3.9; extra == 'plot'",
    ]
    stated = {*WHOLE["dependencies"], *WHOLE["optional-dependencies"]["plot"]}
    assert {need.partition(";")[0] for need in needed} < stated


def test_it_says_of_itself_what_the_whole_project_says(built):
    said = metadata(built.client)
    assert (said["Name"], said["Version"]) == ("zenoh-ogm-client", VERSION)
    assert said["Requires-Python"] == WHOLE["requires-python"]
    assert said["License-Expression"] == WHOLE["license"]
    assert said.get_payload() == README
    with zipfile.ZipFile(built.client) as archive:
        licence = archive.read(f"{NAME}.dist-info/licenses/LICENSE")
    assert licence == (ROOT / "LICENSE").read_bytes()


def test_it_takes_at_most_130_megabytes_with_all_that_it_needs(robot):
    sizes = [path.stat().st_size for path in robot.site.rglob("*") if path.is_file()]
    assert 50e6 < sum(sizes) <= LARGEST
    assert robot.files() > {"numpy/__init__.py", "zenoh/__init__.py", "httpx/__init__.py"}
    assert not (robot.root / "bin/ogm").exists()


def test_every_module_of_it_loads_where_nothing_else_is(built, robot):
    modules = [name.removesuffix(".py") for name in names_in(built.client) if name.endswith(".py")]
    names = sorted(name.removesuffix("/__init__").replace("/", ".") for name in modules)
    program = f"import importlib\nfor name in {names}: print(importlib.import_module(name).__file__)"
    printed = robot.run(robot.python, "-W", "error", "-c", program).stdout.splitlines()
    assert len(printed) == len(names) > 20
    assert all(Path(path).is_relative_to(robot.site) for path in printed)


def test_a_robot_does_what_its_readme_says(robot, services, endpoint, eventually, tmp_path):
    (program,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    assert program.count('"tcp/127.0.0.1:7447"') == 1
    mapper = "mapper", "--listen", endpoint, "--http-port", "0"
    log = services(
        "mapper", [sys.executable, "-m", "ogm_services", *mapper], env=without_settings(os.environ)
    )
    eventually(lambda: re.search(r"live map http://", log.read_text()), STARTED)
    program = program.replace("tcp/127.0.0.1:7447", endpoint)
    printed = robot.run(robot.python, "-W", "error", "-c", program, cwd=tmp_path).stdout
    on_the_circle, inside = map(float, printed.split())
    assert on_the_circle > 0.65
    assert inside < 0.5
    with zipfile.ZipFile(tmp_path / "map.npz") as archive:
        assert "log_odds.npy" in archive.namelist()
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "map.pgm").read_bytes().startswith(b"P5\n")
    assert 'image: "map.pgm"' in (tmp_path / "map.yaml").read_text()


ALONE = """
import sys
from ogm_client import ClientError, MapClient, RobotPublisher
endpoint, url = sys.argv[1:]
asks = (
    lambda: RobotPublisher("r", address=endpoint, wait=False),
    lambda: MapClient(endpoint),
    MapClient(url).get_map,
)
for ask in asks:
    try:
        ask()
    except ClientError as error:
        print(f"{type(error).__name__}: {error}")
"""


def test_without_a_mapper_it_says_what_to_check(robot, endpoint):
    url = f"http://127.0.0.1:{endpoint.rpartition(':')[2]}"
    printed = robot.run(robot.python, "-W", "error", "-c", ALONE, endpoint, url).stdout
    publisher, over_zenoh, over_http = printed.splitlines()
    for line in (publisher, over_zenoh):
        assert line.startswith(f"CannotConnect: cannot connect to {endpoint}: is a mapper running there?")
    assert over_http.startswith("CannotConnect: ")
    assert url in over_http


def test_ogm_does_not_start_beside_it_and_to_uninstall_both_and_install_one_helps(built, tmp_path):
    both = Environment.empty(tmp_path)
    both.pip("install", "--no-deps", built.whole, built.client)
    ended = both.run(both.root / "bin/ogm", "--version", check=False)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert re.fullmatch(
        r"ogm: zenoh-ogm and zenoh-ogm-client are both installed and overwrite each other's files: "
        r"run `pip uninstall zenoh-ogm zenoh-ogm-client`, then install one of the two\n",
        ended.stderr,
    )
    again = both.run(both.python, "-m", "ogm_services", check=False)
    assert (again.returncode, again.stderr) == (1, ended.stderr)
    commands = re.findall(r"^pip (uninstall|install) (.+)$", README.split("## One of the two")[1], re.M)
    assert commands == [("uninstall", "--yes zenoh-ogm zenoh-ogm-client"), ("install", "./clients")]
    both.pip("uninstall", "--yes", "zenoh-ogm", "zenoh-ogm-client")
    assert both.files() == set()
    both.pip("install", "--no-deps", built.client)
    assert names_in(built.client) < both.files()


def test_an_editable_install_leads_to_the_sources(tmp_path):
    editable = Environment.empty(tmp_path)
    editable.pip("install", "--no-deps", "--editable", CLIENTS)
    assert not [name for name in editable.files() if name.startswith("ogm_")]
    find = "import importlib.util as u; print(*(u.find_spec(n).origin for n in ('ogm_client', 'ogm_core')))"
    found = editable.run(editable.python, "-c", find).stdout.split()
    assert found == [str(CLIENTS / "ogm_client/__init__.py"), str(ROOT / "ogm_core/__init__.py")]
