"""What README.md and the pages beside it say in tables, flags, links and make targets is what there is."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import msgpack
import numpy as np
import pytest
import typer

from ogm_core.placing.receipts import DROP_REASONS
from ogm_core.types import IDENTITY, PoseStamped, Scan
from ogm_core.wire.keys import SERVICES, MapKeys
from ogm_core.wire.messages import encode_pose, encode_scan
from ogm_services.cli import app
from ogm_services.runtime import endings
from ogm_services.settings.settings import Settings

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
PAGES = ("README.md", "CONTRIBUTING.md", "docs/architecture.md", "docs/costs.md")


def _table(head):
    """Rows of the table whose head begins so: every cell's text, and the names in `quotes` in it."""
    lines = README[README.index(f"| {head} |") :].split("\n\n")[0].splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def _quoted(text):
    return re.findall(r"`([^`]+)`", text)


def test_table_of_settings():
    documented, section = {}, None
    for names, key, default, _ in _table("section"):
        section = next(iter(_quoted(names)), section)
        documented[section, _quoted(key)[0]] = default
    assert documented == {
        (section, key): "none" if value in (None, ()) else str(value)
        for section, values in Settings()
        for key, value in values
    }


def test_table_of_routes(ogm):
    documented = {_quoted(route)[0]: set(_quoted(parameters)) for route, parameters, _ in _table("route")}
    mapper = ogm.ready(ogm.mapper())
    paths = json.loads(mapper.get("openapi.json"))["paths"]
    served = {
        f"{method.upper()} {path}": {parameter["name"] for parameter in operation.get("parameters", ())}
        for path, operations in paths.items()
        for method, operation in operations.items()
    }
    assert documented == {**served, "GET /docs": set(), "GET /openapi.json": set()}
    assert mapper.get("docs")
    page = mapper.get("").decode()
    assert not re.search(r"https?://|src=|@import|url\(", page)
    asked = set(re.findall(r'["`](/[a-z.]+)[?"`]', page))
    assert {"/map.png", "/status", "/cell", "/quality"} <= asked <= {"/docs", *paths}


def test_table_of_keys():
    keys = MapKeys("M")
    names = {f"{keys.root}/{name}": "get" for name in SERVICES}
    names |= {
        keys.truth: "get",
        keys.pose("R"): "put",
        keys.scan("R", "S"): "put",
        keys.alive("A", "I", "N"): "liveliness",
    }
    short = {"<map>": "M", "<robot>": "R", "<sensor>": "S", "<service>": "A", "<id>": "I", "<run>": "N"}
    documented = {
        re.sub("<[a-z]+>", lambda name: short[name[0]], _quoted(key)[0]): kind
        for key, kind, _ in _table("key")
    }
    assert documented == names


def test_table_of_message_fields():
    documented, message = {}, None
    for first, fields, _ in _table("message"):
        message = first or message
        documented.setdefault(message, []).extend(_quoted(fields))
    scan = Scan(0, 0.0, 0.1, 0.0, 1.0, np.ones(1, np.float32), pose=IDENTITY)
    encoded = {"pose": encode_pose(PoseStamped(0, IDENTITY)), "scan": encode_scan(scan)}
    for message, payload in encoded.items():
        assert set(documented["both"] + documented[message]) == set(msgpack.unpackb(payload))


def test_tables_of_commands_and_drop_reasons():
    commands = typer.main.get_command(app).commands
    assert [_quoted(command)[0].split()[1] for command, _ in _table("command")] == list(commands)
    assert [_quoted(reason)[0] for reason, _ in _table("reason")] == list(DROP_REASONS)


def test_flags_and_exit_codes_exist():
    commands = typer.main.get_command(app).commands.values()
    flags = {flag for command in commands for option in command.params for flag in option.opts} | {"--help"}
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", README.replace("<!--", ""))) - flags == set()
    codes = re.search(r"Exit codes: (\d) done, (\d) .+?, (\d) .+?,\s(\d+) ", README, re.DOTALL).groups()
    expected = (0, endings.FAILED, endings.BAD_INPUT, endings.INTERRUPTED)
    assert tuple(map(int, codes)) == expected


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text()
    links = re.findall(r"\]\((?!http)([^)#]+)\)|src=\"([^\"]+)\"", text)
    assert links
    for link in map("".join, links):
        assert ((ROOT / page).parent / link).exists(), link
    for name in re.findall(r"`((?:ogm_core|services|clients|tests)/[\w/.]*)`", text):
        assert (ROOT / name).exists(), name


def test_make_targets_do_what_is_said():
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    environ = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    does = {"demo": ".venv/bin/ogm demo", "test": ".venv/bin/python -m pytest"}
    mentioned = {target for page in PAGES for target in re.findall(r"make ([a-z]+)", _code(ROOT / page))}
    assert mentioned >= {"demo", "test", "check", "format", "pictures"}
    for target in mentioned:
        ended = subprocess.run(
            ["make", "-n", target], cwd=ROOT, env=environ, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stderr
        assert does.get(target, "") in ended.stdout


def _code(page):
    """What stands in `quotes` and in blocks."""
    text = page.read_text()
    return "\n".join([*re.findall(r"`([^`]+)`", text), *re.findall(r"^```.*?^```", text, re.M | re.S)])
