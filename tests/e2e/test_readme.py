"""README.md and the pages in docs are true: who does what one says, from top to bottom, gets what it shows.

A comment before each block says what to do with it:

    <!-- test: run -->              run it to its end; it succeeds
    <!-- test: run with FILE of the folder FOLDER in OGM_DATASETS -->    likewise, if there is such a folder
    <!-- test: terminal -->         a service that goes on running; a mapper comes after Ctrl-C in all others
    <!-- test: file NAME -->        a file of that name
    <!-- test: not run: why -->

Every page is followed in an empty folder of its own, with nothing running.
"""

import gzip
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
README = "README.md"
PAGES = (README, *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")))
BLOCK = re.compile(
    r"(?:^<!-- test: (?P<mark>[^\n]+) -->\n)?^```(?P<language>\w+)\n(?P<code>.*?)^```$", re.M | re.S
)
TEXTS = {page: (ROOT / page).read_text(encoding="utf-8") for page in PAGES}
BLOCKS = {page: [match.groupdict() for match in BLOCK.finditer(text)] for page, text in TEXTS.items()}
TIMEOUT = 300


class Newcomer:
    """Does what a page says, in one folder, with a mapper on ports of its own."""

    def __init__(self, ogm):
        self.ogm = ogm
        self.folder = ogm.folder
        self.mapper = None
        self.status = None
        self.running = []
        self.left_out = {}

    def follow(self, page):
        """Do what a page says, up to and including its last block; then end what runs."""
        for block in BLOCKS[page]:
            self.follow_block(block)
        if self.mapper is not None:
            self.status = self.mapper.status()
        self.end_services()

    def follow_block(self, block):
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
            self.end_services()
            free = {"OGM_NETWORK__LISTEN": "tcp/127.0.0.1:0", "OGM_HTTP__PORT": "0"}
            self.running.append(self.ogm.start(command, *flags, **free))
            self.mapper = self.ogm.ready(self.running[-1])
        else:
            service = self.ogm.start(command, *flags, OGM_NETWORK__CONNECT=self.mapper.endpoint)
            self.running.append(service)
            service.line(r"robot1.* scans a second")

    def end_services(self):
        """Press Ctrl-C in every terminal."""
        for service in reversed(self.running):
            assert service.stop(signal.SIGINT).code == 0
        self.running.clear()

    def run(self, language, code):
        """Run a block to its end."""
        environ = without_settings(os.environ)
        if self.mapper is not None:
            code = code.replace("tcp/127.0.0.1:7447", self.mapper.endpoint)
            code = code.replace("http://127.0.0.1:8000", self.mapper.url.rstrip("/"))
            environ["OGM_NETWORK__CONNECT"] = self.mapper.endpoint
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
            env={**environ, "PATH": f"{self.programs()}:{os.environ['PATH']}"},
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
        url = "" if self.mapper is None else self.mapper.endpoint
        (folder / "ogm").write_text(
            "#!/bin/sh\n"
            f'case "$1" in get|status) set -- "$@" --url {url} ;; esac\n'
            f'exec {shlex.quote(sys.executable)} -m ogm_services "$@"\n'
        )
        (folder / "ogm").chmod(0o755)
        return folder


@pytest.fixture(scope="module")
def followed(ogm_in, tmp_path_factory):
    """`followed(page)`: who has done everything that a page says."""
    newcomers = {}

    def follow(page):
        if page not in newcomers:
            newcomer = Newcomer(ogm_in(tmp_path_factory.mktemp(Path(page).stem)))
            newcomer.follow(page)
            newcomers[page] = newcomer
        return newcomers[page]

    return follow


def _match(pattern, text):
    return re.fullmatch(pattern, text or "")


def _grey(path):
    with Image.open(path) as picture:
        assert picture.mode == "L"
        return np.asarray(picture)


def _source(newcomer, robot):
    return newcomer.status["robots"][robot]["sources"]["laser"]


@pytest.mark.parametrize("page", PAGES)
def test_every_block_is_run_or_says_why_not(page):
    blocks = BLOCKS[page]
    assert [block["code"] for block in blocks if not block["mark"]] == []
    assert TEXTS[page].count("```") == 2 * len(blocks)
    left_out = [block for block in blocks if block["mark"].startswith("not run")]
    # What needs Docker, jq, a proxy, a bag, a browser, GDAL, or two machines.
    of_pages = {README: 2, "docs/logs.md": 1, "docs/operate.md": 5, "docs/security.md": 6}
    of_pages |= {"docs/ros2.md": 8, "docs/viewers.md": 5, "docs/recordings.md": 2, "docs/http.md": 4}
    of_pages |= {"docs/merging.md": 1, "docs/batch.md": 1, "docs/fleet.md": 4}
    assert len(left_out) == of_pages.get(page, 0)


@pytest.mark.parametrize("page", [page for page in PAGES if BLOCKS[page]])
def test_a_page_can_be_followed(followed, page):
    newcomer = followed(page)
    assert newcomer.running == []
    if page == README:
        assert len(TEXTS[page].splitlines()) <= 200


def test_services_by_hand(followed):
    """The simulator's office: its picture, and the pair for nav2."""
    folder = followed(README).folder
    picture = _grey(folder / "map.png")
    assert {0, 205, 254} == set(np.unique(picture))
    description = yaml.safe_load((folder / "office.yaml").read_text())
    assert (description["image"], description["resolution"]) == ("office.pgm", 0.05)
    assert _grey(folder / "office.pgm").shape >= picture.shape


def test_robot_in_20_lines(followed):
    """The robot maps the room that it says it is in: free inside, walls around, nothing beyond."""
    (code,) = (block["code"] for block in BLOCKS[README] if "RobotPublisher" in block["code"])
    assert len([line for line in code.splitlines() if line.strip()]) <= 20
    with np.load(followed(README).folder / "room.npz") as room:
        log_odds, (x, y), resolution = room["log_odds"], room["origin"], float(room["resolution"])
    assert (x, y) == pytest.approx((-3.05, -2.05))
    assert log_odds.shape == (82, 122)
    assert log_odds[round(-y / resolution), round((1.5 - x) / resolution)] < -5.0
    walls = np.concatenate([log_odds[0], log_odds[-1], log_odds[:, 0], log_odds[:, -1]])
    assert np.mean(walls[~np.isnan(walls)] > 0.0) > 0.95
    assert _source(followed(README), "robot7")["integrated"] == 100


@pytest.mark.parametrize("page", [README, "docs/protocol.md"])
def test_pictures_over_http(followed, page):
    newcomer = followed(page)
    if "curl" in newcomer.left_out:
        pytest.skip(newcomer.left_out["curl"])
    part = _grey(newcomer.folder / "part.png")
    assert part.shape == (40, 40)
    assert part[20, 25] < 10  # free, as a probability


def test_a_robot_and_a_reader_without_the_library(followed):
    newcomer = followed("docs/protocol.md")
    assert _source(newcomer, "robot9")["integrated"] == 50
    picture = _grey(newcomer.folder / "zenoh.png")
    assert picture.shape == (40, 40)
    assert picture[19, 20] == 205  # the sensor's own cell is never updated
    assert np.mean(picture == 254) > 0.995
    assert not (picture == 0).any()


def test_the_client(followed):
    newcomer = followed("docs/client.md")
    assert _source(newcomer, "robot7")["integrated"] == 50
    room = _grey(newcomer.folder / "room.png")
    assert room.shape == _grey(newcomer.folder / "room.pgm").shape
    assert room[room.shape[0] // 2, [0, -1]].tolist() == [255, 255]  # the wall, as a probability
    assert _grey(newcomer.folder / "middle.png").shape == (40, 40)
    corridor = _grey(newcomer.folder / "drive" / "map.png")
    walls, middle = corridor[[0, -1]], corridor[corridor.shape[0] // 2]
    assert (walls == 0).mean() > 0.15, "2 of the 10 m are on either side of the way"
    assert (middle == 254).mean() > 0.9


def test_recorded_log_gives_the_picture_that_is_shown(followed):
    newcomer = followed("docs/logs.md")
    built, shown = (_grey(path) for path in (newcomer.folder / "lab" / "map.png", ROOT / "docs" / "lab.png"))
    assert built.shape == shown.shape
    assert np.mean(built != shown) < 1e-3, "run `make pictures`"
    assert _source(newcomer, "robot1")["integrated"] == 220


def test_other_logs_and_worlds(followed):
    folder = followed("docs/logs.md").folder
    assert (_grey(folder / "two" / "map.png") == 0).sum() == 2
    assert json.loads((folder / "textbook" / "quality.json").read_text())["truth"]["accuracy"] > 0.98
    with Image.open(folder / "textbook" / "figure.png") as figure:
        assert min(figure.size) > 300
    hall = json.loads((folder / "hall" / "quality.json").read_text())["truth"]
    assert min(hall["precision"], hall["recall"]) > 0.95
    with gzip.open(folder / "again.jsonl.gz", "rt") as again:
        assert sum(json.loads(line)["type"] == "scan" for line in again) == 500


def test_robots_that_stand_are_walls_in_one_of_two_maps(followed):
    folder = followed("docs/changing_world.md").folder
    with np.load(folder / "as-walls" / "map.npz") as walls, np.load(folder / "no-walls" / "map.npz") as none:
        assert walls["offset"].tolist() == none["offset"].tolist()
        seen, kept = (grid["log_odds"] > np.log(0.65 / 0.35) for grid in (walls, none))
    yard = np.s_[20:-20, 20:-20]  # a metre and more from its walls
    assert np.count_nonzero(seen[yard]) > 30
    assert not kept[yard].any()


def test_settings_file_environment_and_flag(followed):
    description = yaml.safe_load((followed("docs/settings.md").folder / "coarse" / "map.yaml").read_text())
    assert (description["resolution"], description["origin"]) == (0.1, [-12.0, -12.0, 0.0])


def test_real_building(followed):
    newcomer = followed("docs/logs.md")
    if "intel-corrected.log.gz" in newcomer.left_out:
        pytest.skip(newcomer.left_out["intel-corrected.log.gz"])
    quality = json.loads((newcomer.folder / "intel" / "quality.json").read_text())
    assert quality["held_out"]["within_0_1_m"] >= 0.70
