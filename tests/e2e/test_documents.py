"""What README.md and the pages beside it say in tables, flags, links and make targets is what there is."""

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import get_args

import msgpack
import numpy as np
import pytest
import typer

from ogm_core.placing.receipts import DROP_REASONS
from ogm_core.types import IDENTITY, PoseStamped, Scan
from ogm_core.wire.keys import MapKeys, Service, ShareService
from ogm_core.wire.messages import encode_pose, encode_scan
from ogm_services.cli import app
from ogm_services.runtime import endings
from ogm_services.settings.settings import Settings

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "services" / "ogm_services" / "mapper" / "serving" / "page"
README = "README.md"
DOCS = tuple(sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
PAGES = (README, *DOCS, "CONTRIBUTING.md", "examples/README.md")
TEXTS = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}
PACKAGES = {"ogm_core": ROOT, "ogm_services": ROOT / "services", "ogm_client": ROOT / "clients"}


def _table(page, head):
    """Rows of the page's table whose head begins so: every cell's text."""
    text = TEXTS[page]
    lines = text[text.index(f"| {head} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def _quoted(text):
    return re.findall(r"`([^`]+)`", text)


def test_table_of_settings():
    documented, section = {}, None
    for names, key, default, _ in _table("docs/settings.md", "section"):
        section = next(iter(_quoted(names)), section)
        documented[section, _quoted(key)[0]] = default
    assert documented == {
        (section, key): "none" if value in (None, ()) else str(value).replace("False", "false")
        for section, values in Settings()
        for key, value in values
    }


def test_table_of_routes(ogm):
    documented = {
        _quoted(route)[0]: set(_quoted(parameters))
        for page in (README, "docs/queries.md", "docs/merging.md", "docs/security.md")
        for route, parameters, _ in _table(page, "route")
    }
    mapper = ogm.ready(ogm.mapper())
    paths = json.loads(mapper.get("openapi.json"))["paths"]
    served = {
        f"{method.upper()} {path}": {
            parameter["name"] for parameter in operation.get("parameters", ()) if parameter["in"] != "header"
        }
        for path, operations in paths.items()
        for method, operation in operations.items()
    }
    assert documented == {**served, "GET /docs": set(), "GET /openapi.json": set()}
    assert mapper.get("docs")
    texts = [mapper.get("").decode(), *(file.read_text() for file in PAGE.glob("*.js"))]
    # The namespace of SVG is a name, which nobody loads.
    assert not any(
        re.search(r'https?://(?!www\.w3\.org/2000/svg")|src="(?!\{static\}|static/)|@import|url\(', text)
        for text in texts
    )
    asked = set(re.findall(r'(?:href=|\bask(?:Json)?\()["`]([a-z.]+)[?"`]', "".join(texts)))
    assert (
        {"map.png", "status", "cell", "quality", "tiles.json"}
        <= asked
        <= {"docs", *(path[1:] for path in paths)}
    )


def test_table_of_keys():
    keys = MapKeys("M")
    names = {f"{keys.root}/{name}": "get" for name in get_args(Service)}
    names |= {keys.share(0, name).replace("/0/", "/<K>/"): "get" for name in get_args(ShareService)}
    names |= {
        keys.truth: "get",
        keys.updates: "put",
        keys.pose("R"): "put",
        keys.scan("R", "S"): "put",
        keys.alive("A", "I", "N"): "liveliness",
    }
    short = {"<map>": "M", "<robot>": "R", "<sensor>": "S", "<service>": "A", "<id>": "I", "<run>": "N"}
    documented = {
        re.sub("<[a-z]+>", lambda name: short[name[0]], _quoted(key)[0]): kind
        for key, kind, _ in _table("docs/protocol.md", "key")
    }
    assert documented == names


def test_table_of_message_fields():
    documented, message = {}, None
    for first, fields, _ in _table("docs/protocol.md", "message"):
        message = first or message
        documented.setdefault(message, []).extend(_quoted(fields))
    scan = Scan(0, 0.0, 0.1, 0.0, 1.0, np.ones(1, np.float32), pose=IDENTITY)
    encoded = {"pose": encode_pose(PoseStamped(0, IDENTITY)), "scan": encode_scan(scan)}
    for message, payload in encoded.items():
        assert set(documented["both"] + documented[message]) == set(msgpack.unpackb(payload))


def test_tables_of_commands_and_drop_reasons():
    commands = typer.main.get_command(app).commands
    assert [_quoted(command)[0].split()[1] for command, _ in _table(README, "command")] == list(commands)
    assert [_quoted(reason)[0] for reason, _ in _table("docs/operate.md", "reason")] == list(DROP_REASONS)


@pytest.mark.parametrize("page", [README, *DOCS])
def test_flags_exist(page):
    program = typer.main.get_command(app)
    groups = [group for group in program.commands.values() if hasattr(group, "commands")]
    commands = [command for group in (program, *groups) for command in group.commands.values()]
    options = [option for command in (program, *commands) for option in command.params]
    flags = {flag for option in options for flag in option.opts} | {"--help"}
    flags |= {"--meta", "--output-path"} if page == "docs/http.md" else set()  # openapi-python-client's
    dask = {"--nworkers", "--nthreads", "--scheduler-file", "--memory-limit"}
    flags |= dask if page == "docs/batch.md" else set()
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", TEXTS[page].replace("<!--", ""))) - flags == set()


def test_exit_codes():
    codes = re.search(
        r"Exit codes: (\d) done, (\d) .+?, (\d) .+?,\s(\d+) ", TEXTS["docs/operate.md"], re.DOTALL
    )
    expected = (0, endings.FAILED, endings.BAD_INPUT, endings.INTERRUPTED)
    assert tuple(map(int, codes.groups())) == expected


def _anchors(page):
    """What a link's `#part` may be: the page's headings, as GitHub writes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\((?!http)([^)]+)\)|src=\"(?!http)([^\"]+)\"", TEXTS[page])
    assert links
    for link in map("".join, links):
        path, _, part = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        assert not part or part in _anchors(target), link


def test_every_page_can_be_reached_from_the_first():
    reached, waiting = set(), [README]
    while waiting:
        page = waiting.pop()
        reached.add(page)
        linked = re.findall(r"\]\((?!http)([^)#]+\.md)[^)]*\)", (ROOT / page).read_text(encoding="utf-8"))
        paths = {os.path.relpath((ROOT / page).parent / link, ROOT) for link in linked}
        waiting.extend(paths - reached - set(waiting))
    assert set(PAGES) <= reached


def _modules():
    """Every module of the three packages, by its path below the project's folder."""
    return {
        str(path.relative_to(ROOT)): importlib.import_module(
            ".".join(path.relative_to(parent).with_suffix("").parts)
        )
        for package, parent in PACKAGES.items()
        for path in sorted((parent / package).rglob("*.py"))
        if path.name not in ("__init__.py", "__main__.py")
    }


@pytest.fixture(scope="module")
def modules():
    return _modules()


def _has(module, name):
    """Whether a module has what a dotted name says."""
    found = module
    for part in name.split("."):
        if not hasattr(found, part):
            return False
        found = getattr(found, part)
    return True


def _lines_of_thought(text):
    """Rows of tables, and paragraphs or items of lists."""
    return re.split(r"\n(?=\|)|\n\n|\n(?=- |\d\. )", text)


PATH = re.compile(r"(?:ogm_core|services|clients|tests|benchmarks|examples|docker|docs)/[\w/.-]*")
CALL = re.compile(r"([A-Za-z_][\w.]*)\(\)")
NAME = re.compile(r"(?:[A-Z]+[a-z]+\w*|[A-Z]+_[A-Z_]+)(?:\.\w+)*")


@pytest.mark.parametrize("page", ["docs/method.md", "docs/architecture.md", "CONTRIBUTING.md"])
def test_what_a_page_names_exists(page, modules):
    missing = []
    for thought in _lines_of_thought(TEXTS[page]):
        quoted = _quoted(thought)
        paths = list(filter(PATH.fullmatch, quoted))
        missing += [path for path in paths if not (ROOT / path).exists()]
        near = [modules[path] for path in paths if path in modules] or list(modules.values())
        for name in quoted:
            call = CALL.fullmatch(name)
            if call and not any(_has(module, call[1]) for module in near):
                missing.append(name)
            if NAME.fullmatch(name) and not name.startswith("OGM_"):
                missing += [] if any(_has(module, name) for module in modules.values()) else [name]
    assert missing == []


def test_the_picture_of_the_architecture_names_what_exists(modules):
    texts = re.findall(
        r">([^<>\n]+)</text>", (ROOT / "docs" / "architecture.svg").read_text(encoding="utf-8")
    )
    names = [text for text in texts if re.fullmatch(r"[A-Z]\w*[a-z][A-Z]\w*(\.\w+)?", text)]
    assert len(names) >= 7
    files = {Path(path).stem for path in modules}
    names += [text for text in texts if re.fullmatch("[a-z]+_[a-z]+", text)]
    assert [
        name for name in names if name not in files and not any(_has(m, name) for m in modules.values())
    ] == []


def test_every_line_of_the_method_names_a_function_and_its_file(modules):
    text = TEXTS["docs/method.md"]
    rows = [
        row
        for head in re.findall(r"\| line \|.*?(?=\n\n|\Z)", text, re.DOTALL)
        for row in head.splitlines()[2:]
    ]
    assert len(rows) >= 35
    for row in rows:
        _, done_by = row.strip("|").rsplit("|", 1)
        quoted = _quoted(done_by)
        assert [name for name in quoted if name in modules], row
        names = [name.removesuffix("()") for name in quoted if name not in modules]
        assert names, row
        for name in names:
            assert any(_has(modules[path], name) for path in quoted if path in modules), (name, row)


def test_the_rooms_are_those_of_the_import_contracts():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = {
        contract["containers"][0]: contract["layers"] for contract in contracts if "containers" in contract
    }
    assert len(layers) == 3
    for container, expected in layers.items():
        folder = "services/" * (container != "ogm_core") + container.replace(".", "/") + "/"
        floors = []
        for floor, room, about in _table("docs/architecture.md", rf"floor | `{folder}`"):
            if floor:
                floors.append(set())
            floors[-1].update(_quoted(room))
            assert about, room
        there = [{room for room in re.split(r"\s*[|:]\s*", layer) if "(" not in room} for layer in expected]
        assert floors == there


def test_the_locks_of_a_mapper_are_those_of_the_table():
    documented = {
        (name, lock)
        for locks, where, held in _table("docs/architecture.md", "lock | in | held while")
        for name in _quoted(where)
        for lock in _quoted(locks)
        if held
    }
    found = {key for text in _texts_of_a_mapper() for key in _locks(text)}
    assert len(found) >= 30
    assert documented == found


def test_the_threads_of_a_mapper_are_those_of_the_table():
    rows = _table("docs/architecture.md", "thread | does | must not")
    documented = {name for names, does, _ in rows for name in _quoted(names) if does}
    texts = "\n".join(_texts_of_a_mapper())
    made = re.findall(r'(?:name=|ThreadPoolExecutor\(\w+, |Helper\(f)"(ogm-[a-z-]+)(?:\{.*\})?"', texts)
    kinds = re.findall(r'Turns\("(\w+)"', texts)
    assert len(kinds) == 4
    assert documented == {name.removesuffix("-") + "-N" * name.endswith("-") for name in made} | {
        f"ogm-{kind}" for kind in kinds
    }


def _texts_of_a_mapper():
    """What its rooms hold, file by file."""
    rooms = ["ogm_core", *(f"services/ogm_services/{room}" for room in ("mapper", "replies", "runtime"))]
    return [path.read_text(encoding="utf-8") for room in rooms for path in (ROOT / room).rglob("*.py")]


def _locks(text):
    """Classes that others may name and their locks, `(class, attribute)`."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            made = re.findall(r"self\.(\w+) = threading\.(?:R?Lock|Condition)\(", ast.unparse(node))
            yield from ((node.name, lock) for lock in made)


def test_make_targets_do_what_is_said():
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    environ = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    does = {"demo": ".venv/bin/ogm demo", "test": ".venv/bin/python -m pytest"}
    mentioned = {target for page in PAGES for target in re.findall(r"make ([a-z0-9-]+)", _code(TEXTS[page]))}
    assert mentioned >= {
        "demo",
        "test",
        "check",
        "format",
        "pictures",
        "page-picture",
        "test-ros2",
        "test-clients",
    }
    for target in mentioned:
        ended = subprocess.run(
            ["make", "-n", target], cwd=ROOT, env=environ, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stderr
        assert does.get(target, "") in ended.stdout


@pytest.mark.parametrize("target", ["demo", "test"])
def test_the_first_make_says_how_much_it_installs_before_it_does(target, tmp_path):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    environ = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    command = ["make", "-n", target, f"VENV={tmp_path / 'venv'}"]
    ended = subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    lines = ended.stdout.splitlines()
    (said,) = (number for number, line in enumerate(lines) if line.startswith("echo"))
    (installed,) = (number for number, line in enumerate(lines) if "pip install" in line)
    assert said == installed - 1
    assert re.search(r"once.* GB on disk", lines[said])


def _code(text):
    """What stands in `quotes` and in blocks."""
    return "\n".join([*re.findall(r"`([^`]+)`", text), *re.findall(r"^```.*?^```", text, re.M | re.S)])


def test_the_changelog_tells_of_this_version():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    _, *sections = re.split(r"^## ", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), flags=re.M)
    assert re.findall(r"\[([\d.]+)\]", sections[0].splitlines()[0]) == [version]
    assert len(re.findall(r"^- ", sections[0], flags=re.M)) > 20
