"""The live page, as a browser shows it: robots that are there, and what keeps scans out of the map."""

import json
import re
import shutil
import subprocess
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from ogm_core.status import RobotStatus, SourceStatus, encode_status
from ogm_core.types import Pose
from ogm_services.mapper.serving.page_routes import PageFiles
from ogm_services.replies.what_helps import HINT_HELPS, LOST_HELPS, ON_ROBOTS_MEANS, WHAT_HELPS
from status_json import STATUS

PAGE = PageFiles()
TILES = {"epoch": "e1", "run": "r1", "revision": 41, "resolution": 0.05, "anchor": [0.0, 0.0], "extent": None}
TILES |= {"palettes": ["ros"], "legend": {"ros": {"occupied": "#000000", "unknown": "#cdcdcd"}}}
TYPES = {"js": "text/javascript", "css": "text/css", "json": "application/json"}
QUALITY = {"scans": 0, "truth": None, "free_m2": 0.0, "occupied_m2": 0.0, "series": {"revision": []}}
QUALITY |= {"consistency": {"hits": None, "free": None}}
HERE = Pose(1.0, -2.5, 0.0)


@pytest.fixture
def shown(tmp_path):
    """`shown(status)`: the page's document, once a browser has filled it in."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium is installed")

    def show(status):
        answers = {
            "/": PAGE.document,
            **{f"/static/{PAGE.version}/{name}": text for name, text in PAGE.texts.items()},
            "/tiles.json": json.dumps({"name": "hall", "ogm": TILES}).encode(),
            "/status": encode_status(status),
            "/quality": json.dumps(QUALITY).encode(),
        }

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                body = answers.get(self.path)
                self.send_response(404 if body is None else 200)
                self.send_header("Content-Type", TYPES.get(self.path.rpartition(".")[2], "text/html"))
                self.end_headers()
                self.wfile.write(body or b"")

            def log_message(self, *args):
                """Stay silent."""

        with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
            server.daemon_threads = True
            thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
            thread.start()
            try:
                done = subprocess.run(
                    [
                        *(
                            browser,
                            "--headless",
                            "--no-sandbox",
                            "--disable-gpu",
                            "--disable-background-networking",
                        ),
                        *(
                            f"--user-data-dir={tmp_path / 'profile'}",
                            "--virtual-time-budget=5000",
                            "--dump-dom",
                        ),
                        f"http://127.0.0.1:{server.server_port}/",
                    ],
                    capture_output=True,
                    text=True,
                    timeout=300,
                    check=True,
                )
            finally:
                server.shutdown()
                thread.join()
        assert "waiting for the first scan" in done.stdout
        return done.stdout

    return show


def rows(dom, table):
    (inside,) = re.findall(rf'<table id="{table}">(.*?)</table>', dom, re.DOTALL)
    return [texts(row) for row in re.findall("<tr>(.*?)</tr>", inside)]


def texts(inside):
    return [text for text in re.split("<[^>]*>", inside) if text]


def cards(dom):
    (inside,) = re.findall(r'<ul id="robots">(.*?)</ul>', dom, re.DOTALL)
    return [(kind, texts(card)) for kind, card in re.findall(r'<li(?: class="(.*?)")?>(.*?)</li>', inside)]


def test_the_page_tells_who_is_there_and_what_is_not_in_the_map(shown):
    front = SourceStatus("a", 9, 12, 1, 4, {"no_pose": 5, "superseded": 2}, ["range_max"], 3, 6)
    status = replace(
        STATUS,
        map_info=replace(STATUS.map_info, width=0, height=0),
        robots={
            "here": RobotStatus(HERE, 7, True, 0.25, {"front": front}),
            "quiet": RobotStatus(None, None, True, None),
            "still": RobotStatus(HERE, 7, True, 5.5),
            "leaving": RobotStatus(HERE, 7, False, 59.0, {"s": SourceStatus("a", 1, 2, 0, 2)}),
            "gone": RobotStatus(HERE, 7, False, 61.0, {"s": SourceStatus("a", 1, 2, 0, 1, {"stale": 1})}),
        },
    )
    dom = shown(status)
    helped = [
        *("front: no_pose", "5", WHAT_HELPS["no_pose"], "front: superseded", "2", WHAT_HELPS["superseded"]),
        *("front: lost", "3", LOST_HELPS, "front: beams on robots", "6", ON_ROBOTS_MEANS),
        *("front: hint range_max", HINT_HELPS),
    ]
    said = "10 not in the map: no_pose, superseded, lost, beams on robots, hint range_max"
    assert cards(dom) == [
        ("", ["here", "alive", "1.0, -2.5 m", "4 scans, 0.0 /s", said, *helped]),
        ("silent", ["leaving", "silent 59 s", "1.0, -2.5 m", "2 scans"]),
        ("silent", ["quiet", "never heard", "no pose", "0 scans"]),
        ("silent", ["still", "silent 6 s", "1.0, -2.5 m", "0 scans"]),
    ]
    assert '<small id="count">4</small>' in dom
    told = dict(row for row in rows(dom, "facts") if row[0].startswith("poses "))
    assert told == {
        "poses malformed": "1",
        "poses late": "3",
        "poses restarted": "2",
        "poses ambiguous": "4",
        "poses outlier": "5",
        "poses superseded": "6",
        "poses refused": "7",
        "poses lost": "10",
    }
    facts = dict(rows(dom, "facts"))
    assert facts["scans lost"] == "8"
    assert not [name for name in facts if "replayed" in name]
    assert "· 8 lost</span>" in dom
    assert 'id="missing" open="" hidden=""' in dom


def test_a_page_of_a_map_that_lacks_nothing_says_nothing_of_it(shown):
    status = replace(STATUS, map_info=replace(STATUS.map_info, width=0, height=0), robots={})
    dom = shown(status)
    assert cards(dom) == []
    assert '<small id="count">none yet</small>' in dom
