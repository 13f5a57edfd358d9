"""A mapper in a process of its own, which may be killed, and a browser's page of it, with its complaints."""

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from urllib.parse import urlsplit

import httpx

from benchmarks.workloads import lab_exercise
from ogm_client import RobotPublisher
from ogm_client.session import resolve_listen
from ogm_services.settings.sources import without_settings

STARTED = 120.0
"""How long a mapper may take to start, s: on a fresh checkout it compiles its kernels."""
PATIENCE = 30.0
"""When what a page should show is given up, s."""


class MapperProcess:
    """`ogm mapper` on ports that stay the same when it is started again; it keeps nothing."""

    def __init__(self, *flags):
        self.endpoint = resolve_listen("tcp/127.0.0.1:0")
        self.port = int(resolve_listen("tcp/127.0.0.1:0").rpartition(":")[2])
        self.url = f"http://127.0.0.1:{self.port}/"
        self.flags = flags
        self.process = None
        self.http = httpx.Client(base_url=self.url, timeout=PATIENCE)

    def start(self):
        """Start it, and wait until it is ready."""
        network = "--listen", self.endpoint, "--http-port", str(self.port)
        self.process = subprocess.Popen(
            [sys.executable, "-m", "ogm_services", "mapper", *network, "--log-level", "warning", *self.flags],
            env=without_settings(os.environ),
            stdout=subprocess.DEVNULL,
        )
        deadline = time.monotonic() + STARTED
        while not self._ready():
            assert self.process.poll() is None, "the mapper has ended"
            assert time.monotonic() < deadline, "the mapper does not start"
            time.sleep(0.01)

    def kill(self):
        """End it without a word."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def stop(self):
        """End it, if it still runs."""
        self.http.close()
        if self.process is not None and self.process.poll() is None:
            self.process.terminate()
            assert self.process.wait(PATIENCE) == 0

    def get(self, path, **headers):
        """The response of a route."""
        return self.http.get(path, headers=headers)

    def post(self, path):
        """Ask for a write."""
        return self.http.post(path).raise_for_status()

    def integrated(self):
        """How many scans are in the map."""
        return self.get("status").json()["scans"]["integrated"]

    @contextmanager
    def robot(self, name="robot1"):
        """A robot that the mapper hears."""
        with RobotPublisher(name, address=self.endpoint, reliable=True) as robot:
            robot.wait_for_mapper(PATIENCE)
            yield robot

    def drive(self, robot, scans, eventually):
        """Have a robot send scans, and wait until they are in the map."""
        wanted = self.integrated() + len(scans)
        for scan, *_ in scans:
            robot.put_scan("laser", scan)
        eventually(lambda: self.integrated() == wanted)

    def _ready(self):
        with suppress(httpx.TransportError):
            return self.get("readyz").status_code == 200
        return False


def lap():
    """The scans of a lap through the lab, each with its pose."""
    return lab_exercise().scans


def module(name):
    """Script: the import of one of the page's modules."""
    return f"import(document.querySelector('[src$=\"/main.js\"]').src.replace(/main.js$/, '{name}.js'))"


class WatchedPage:
    """A page of a mapper in a browser; `complaints` are what it and its requests say."""

    def __init__(self, page, url):
        self.page = page
        self.url = url
        self.complaints = []
        origin = urlsplit(url).netloc
        page.on("console", lambda said: self._complain(said.type in ("error", "warning"), said.text))
        page.on("pageerror", lambda error: self._complain(True, str(error)))
        page.on("requestfailed", lambda asked: self._complain(True, f"{asked.url}: {asked.failure}"))
        page.on("response", lambda got: self._complain(got.status >= 400, f"{got.url}: {got.status}"))
        page.on("request", lambda asked: self._complain(_is_elsewhere(asked.url, origin), asked.url))

    def _complain(self, condition, said):
        if condition:
            self.complaints.append(said)

    def open(self, hash_=""):
        """Go to the page, and wait until it is live and shows the newest map."""
        self.page.goto(self.url + hash_)
        self.settle()

    def state(self):
        """Class and text of the page's status."""
        status = self.page.locator("#state[role=status]")
        return status.get_attribute("class") or "", status.text_content()

    def settle(self):
        """Wait until it is live, and shows each tile as the mapper has it now."""
        deadline = time.monotonic() + PATIENCE
        while not (self.state()[1] == "live" and self.page.evaluate(SETTLED)):
            assert time.monotonic() < deadline, (self.state(), self.page.evaluate(TILES), self.complaints)
            time.sleep(0.02)

    def show(self, x, y, zoom):
        """Put a place into the middle of the view."""
        self.page.evaluate("([x, y, zoom]) => ogm.view.centreOn(x, y, zoom)", [x, y, zoom])
        self.settle()

    def place(self, x, y):
        """Where a point of the map is in the window, CSS pixels."""
        found = self.page.evaluate(
            """([x, y]) => {
              const box = document.getElementById("map").getBoundingClientRect();
              const [u, v] = ogm.view.now().toCanvas(x, y);
              return [box.left + u, box.top + v];
            }""",
            [x, y],
        )
        return tuple(found)

    def colour(self, x, y):
        """The colour in which a point of the map is drawn, #rrggbb; transparent: what is below it."""
        return self.page.evaluate(COLOUR, [x, y])


SETTLED = """() => ogm.tiles && !ogm.tiles.awaiting && !ogm.tiles.asking.size && ogm.tiles.wanted.length > 0
  && ogm.tiles.wanted.every((place) => {
    const tile = ogm.tiles.held.get(place.join("/"));
    return tile && (tile.live || tile.at >= ogm.state.map.revision) && !tile.png === !tile.bitmap;
  }) && (ogm.fitting.fitted || ogm.view.touched) && !ogm.canvas.frame"""
TILES = "() => ogm.tiles && [...ogm.tiles.held].map(([key, {r, at, live}]) => [key, r, at, live])"
# Looked at in a copy: browsers advise against reading what is drawn on.
COLOUR = """([x, y]) => {
  const [u, v] = ogm.view.now().toCanvas(x, y).map((at) => Math.floor(at * devicePixelRatio));
  const pen = new OffscreenCanvas(1, 1).getContext("2d");
  pen.drawImage(ogm.canvas.canvas, -u, -v);
  const [red, green, blue, alpha] = pen.getImageData(0, 0, 1, 1).data;
  const hex = [red, green, blue].map((part) => part.toString(16).padStart(2, "0")).join("");
  return alpha ? `#${hex}` : "transparent";
}"""


def _is_elsewhere(url, origin):
    found = urlsplit(url)
    return found.scheme not in ("data", "blob") and found.netloc != origin
