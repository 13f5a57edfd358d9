"""README.md is true: a newcomer who does what it says, from top to bottom, gets what it shows.

A comment before each block says what to do with it:

    <!-- test: run -->              run it to its end; it succeeds
    <!-- test: run with FILE of the folder FOLDER in OGM_DATASETS -->    likewise, if there is such a folder
    <!-- test: terminal -->         a service that goes on running; a mapper comes after Ctrl-C in all others
    <!-- test: file NAME -->        a file of that name
    <!-- test: not run: why -->
"""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image

from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCK = re.compile(
    r"(?:^<!-- test: (?P<mark>[^\n]+) -->\n)?^```(?P<language>\w+)\n(?P<code>.*?)^```$", re.M | re.S
)
BLOCKS = [match.groupdict() for match in BLOCK.finditer(README)]
TIMEOUT = 120


class Newcomer:
    """Does what README.md says, in one folder, with a mapper on ports of its own."""

    def __init__(self, ogm):
        self.ogm = ogm
        self.folder = ogm.folder
        self.mapper = None
        self.running = []
        self.left_out = {}

    def follow(self, block):
        """Do what one block says."""
        mark, language, code = block["mark"], block["language"], block["code"]
        if mark == "terminal":
            self.open_terminal(shlex.split(code, comments=True))
        elif name := _match(r"file (\S+)", mark):
            (self.folder / name[1]).write_text(code)
        elif data := _match(r"run with (\S+) of the folder (\S+) in OGM_DATASETS", mark):
            if source := os.environ.get("OGM_DATASETS"):
                shutil.copy(Path(source) / data[2] / data[1], self.folder)
                self.run(language, code)
            else:
                self.left_out[data[1]] = "OGM_DATASETS is not set"
        elif mark == "run":
            self.run(language, code)
        else:
            assert _match(r"not run: .{10,}", mark), f"not a mark: {mark}"

    def open_terminal(self, words):
        """Start a service; a mapper comes after Ctrl-C in every terminal."""
        program, command, *flags = words
        assert program == "ogm"
        if command == "mapper":
            for service in reversed(self.running):
                assert service.stop(signal.SIGINT).code == 0
            self.running.clear()
            free = {"OGM_NETWORK__LISTEN": "tcp/127.0.0.1:0", "OGM_HTTP__PORT": "0"}
            self.running.append(self.ogm.start(command, *flags, **free))
            self.mapper = self.ogm.ready(self.running[-1])
        else:
            service = self.ogm.start(command, *flags, OGM_NETWORK__CONNECT=self.mapper.endpoint)
            self.running.append(service)
            service.line(r"robot1.* scans a second")

    def run(self, language, code):
        """Run a block to its end."""
        code = code.replace("tcp/127.0.0.1:7447", self.mapper.endpoint)
        code = code.replace("http://127.0.0.1:8000", self.mapper.url.rstrip("/"))
        if language == "python":
            words = [sys.executable, "-W", "error", "-c", code]
        else:
            words = ["sh", "-euc", 'curl() { command curl -fsS "$@"; echo; }\n' + code]
            if "\ncurl" in f"\n{code}" and shutil.which("curl") is None:
                self.left_out["curl"] = "curl is not installed"
                return
        ended = subprocess.run(
            words,
            cwd=self.folder,
            env={
                **without_settings(os.environ),
                "PATH": f"{self.programs()}:{os.environ['PATH']}",
                "OGM_NETWORK__CONNECT": self.mapper.endpoint,
            },
            capture_output=True,
            text=True,
            timeout=TIMEOUT,
            check=False,
        )
        assert ended.returncode == 0, f"{code}\n{ended.stdout}{ended.stderr}"
        assert "Traceback" not in ended.stderr, f"{code}\n{ended.stderr}"

    def programs(self):
        """A folder with an `ogm` that looks for its mapper where this one is."""
        folder = self.folder / "programs"
        folder.mkdir(exist_ok=True)
        (folder / "ogm").write_text(
            "#!/bin/sh\n"
            f'case "$1" in get|status) set -- "$@" --url {self.mapper.endpoint} ;; esac\n'
            f'exec {shlex.quote(sys.executable)} -m ogm_services "$@"\n'
        )
        (folder / "ogm").chmod(0o755)
        return folder


@pytest.fixture(scope="module")
def newcomer(module_ogm):
    """Who has done everything that README.md says, up to and including the last block."""
    newcomer = Newcomer(module_ogm)
    for block in BLOCKS:
        newcomer.follow(block)
    return newcomer


def _match(pattern, text):
    return re.fullmatch(pattern, text or "")


def _grey(path):
    with Image.open(path) as picture:
        assert picture.mode == "L"
        return np.asarray(picture)


def test_every_block_is_run_or_says_why_not():
    assert [block["code"] for block in BLOCKS if not block["mark"]] == []
    assert README.count("```") == 2 * len(BLOCKS)
    assert sum(block["mark"].startswith("not run") for block in BLOCKS) == 2


def test_services_by_hand(newcomer):
    """The simulator's office: its picture, and the pair for nav2."""
    picture = _grey(newcomer.folder / "map.png")
    assert {0, 205, 254} == set(np.unique(picture))
    description = yaml.safe_load((newcomer.folder / "office.yaml").read_text())
    assert (description["image"], description["resolution"]) == ("office.pgm", 0.05)
    assert _grey(newcomer.folder / "office.pgm").shape >= picture.shape


def test_robot_in_20_lines(newcomer):
    """The robot maps the room that it says it is in: free inside, walls around, nothing beyond."""
    (code,) = (block["code"] for block in BLOCKS if "RobotPublisher" in block["code"])
    assert len([line for line in code.splitlines() if line.strip()]) <= 20
    with np.load(newcomer.folder / "room.npz") as room:
        log_odds, (x, y), resolution = room["log_odds"], room["origin"], float(room["resolution"])
    assert (x, y) == pytest.approx((-3.05, -2.05))
    assert log_odds.shape == (82, 122)
    assert log_odds[round(-y / resolution), round((1.5 - x) / resolution)] < -5.0
    walls = np.concatenate([log_odds[0], log_odds[-1], log_odds[:, 0], log_odds[:, -1]])
    assert np.mean(walls[~np.isnan(walls)] > 0.0) > 0.95
    sources = {name: robot["sources"] for name, robot in newcomer.mapper.status()["robots"].items()}
    assert sources["robot7"]["laser"]["integrated"] == 100


def test_pictures_over_http_and_zenoh_and_the_client(newcomer):
    assert np.all(_grey(newcomer.folder / "zenoh.png") == 254)
    assert _grey(newcomer.folder / "room.png").shape == _grey(newcomer.folder / "room.pgm").shape == (82, 122)
    if "curl" in newcomer.left_out:
        pytest.skip(newcomer.left_out["curl"])
    assert _grey(newcomer.folder / "part.png").shape == (40, 40)


def test_recorded_log_gives_the_picture_that_is_shown(newcomer):
    built, shown = (_grey(path) for path in (newcomer.folder / "lab" / "map.png", ROOT / "docs" / "lab.png"))
    assert built.shape == shown.shape
    assert np.mean(built != shown) < 1e-3, "run `make pictures`"
    robots = newcomer.mapper.status()["robots"]
    assert robots["robot1"]["sources"]["laser"]["integrated"] == 220


def test_settings_file_environment_and_flag(newcomer):
    description = yaml.safe_load((newcomer.folder / "coarse" / "map.yaml").read_text())
    assert (description["resolution"], description["origin"]) == (0.1, [-12.0, -12.0, 0.0])


def test_real_building(newcomer):
    if "intel-corrected.log.gz" in newcomer.left_out:
        pytest.skip(newcomer.left_out["intel-corrected.log.gz"])
    quality = json.loads((newcomer.folder / "intel" / "quality.json").read_text())
    assert quality["held_out"]["within_0_1_m"] >= 0.70
