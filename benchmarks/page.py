"""What the live page takes: until it shows a map, and how smoothly a map of 4000 x 4000 cells is dragged.

Chromium without a window, 1400 x 900 pixels, drawn by the processor, beside the mapper on the same machine.
The map is dragged in circles by mouse events, one a frame, which brings new tiles all the time; the same
loop on a blank page, in turns with it, is what this machine can do at all. Without Chromium or Playwright
(the extra web-test) it is left out, and says so.
"""

import shutil
import statistics
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.running import mapper
from benchmarks.table import Result

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

SIDE = 4000
ROUNDS, QUICK_ROUNDS = 5, 2
SECONDS, QUICK_SECONDS = 4.0, 2.0
READY_TARGET, FPS_TARGET, WORK_TARGET = 1.5, 55.0, 8.0
PATIENCE = 30.0
BROWSERS = "chromium", "chromium-browser", "google-chrome"
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage"]
SIZE = {"width": 1400, "height": 900}

READY = """() => document.getElementById("state").textContent === "live"
  && [...ogm.tiles.held.values()].some(({bitmap}) => bitmap)
  && performance.now() / 1000"""
DRAG = """(seconds) => new Promise((done) => {
  const held = document.querySelector(".leaflet-map-pane") ?? document.body;
  const at = (angle) => ({clientX: 500 + 300 * Math.cos(angle), clientY: 450 + 300 * Math.sin(angle)});
  const fire = (target, kind, angle) => target.dispatchEvent(
    new MouseEvent(kind, {bubbles: true, cancelable: true, button: 0, buttons: 1, ...at(angle)}));
  fire(held, "mousedown", 0);
  const began = performance.now();
  let frames = 0;
  const step = (now) => {
    const passed = (now - began) / 1000;
    if (passed >= seconds) {
      fire(document, "mouseup", 0);
      done(frames / passed);
      return;
    }
    frames += 1;
    fire(document, "mousemove", 2 * passed);
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
})"""


def run(quick: bool) -> list[Result]:
    """Measure; the median of some rounds."""
    rounds, seconds = (QUICK_ROUNDS, QUICK_SECONDS) if quick else (ROUNDS, SECONDS)
    missing = what_is_missing()
    if missing:
        print(f"page: {missing}; left out")
        return []
    with tempfile.TemporaryDirectory(prefix="ogm-page-") as folder:
        start = walls(Path(folder))
        with mapper("--start-map", str(start)) as running, browser() as opened:
            ready = statistics.median(_ready(opened, running.url) for _ in range(rounds))
            dragged = [_dragged(opened, running.url, seconds) for _ in range(rounds)]
    ours, work, blank = (statistics.median(rates) for rates in zip(*dragged, strict=True))
    group = f"the live page of a map of {SIDE} x {SIDE} cells, in Chromium"
    return [
        Result(group, "until the map is there", ready, "s", READY_TARGET, at_least=False),
        Result(group, "frames a second while it is dragged", ours, "/s", FPS_TARGET),
        Result(group, "the same of a blank page", blank, "/s"),
        Result(
            group, "time of the page's main thread in a frame", 1e3 * work, "ms", WORK_TARGET, at_least=False
        ),
    ]


def what_is_missing() -> str | None:
    """Why a page cannot be looked at here; None: it can."""
    try:
        import playwright.sync_api  # noqa: F401
    except ModuleNotFoundError:
        return "Playwright is not installed (the extra web-test)"
    return None if any(map(shutil.which, BROWSERS)) else "Chromium is not installed"


def walls(folder: Path) -> Path:
    """A ROS map of SIDE x SIDE cells of 5 cm: walls in both directions, and what is unknown between."""
    rng = np.random.default_rng(1)
    grey = np.full((SIDE, SIDE), 254, np.uint8)
    grey[rng.random((SIDE // 20, SIDE // 20)).repeat(20, 0).repeat(20, 1) < 0.2] = 205
    for first, second in rng.integers(0, SIDE - 200, (400, 2)):
        grey[first, second : second + 200] = 0
        grey[second : second + 200, first] = 0
    (folder / "walls.pgm").write_bytes(b"P5\n%d %d\n255\n" % (SIDE, SIDE) + grey.tobytes())
    path = folder / "walls.yaml"
    path.write_text(
        "image: walls.pgm\nresolution: 0.05\norigin: [-100.0, -100.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    return path


@contextmanager
def browser() -> Iterator["Browser"]:
    """A Chromium without a window."""
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, BROWSERS)))
    with sync_playwright() as playwright:
        opened = playwright.chromium.launch(executable_path=path, args=FLAGS)
        try:
            yield opened
        finally:
            opened.close()


@contextmanager
def _page(opened: "Browser", url: str) -> Iterator["Page"]:
    """A page, of which nothing is kept from others."""
    context = opened.new_context(viewport=SIZE)
    try:
        page = context.new_page()
        page.goto(url)
        yield page
    finally:
        context.close()


def _ready(opened: "Browser", url: str) -> float:
    """From its request until a page is live and shows a tile, s."""
    with _page(opened, url) as page:
        return _once(page)


def _once(page: "Page") -> float:
    deadline = time.monotonic() + PATIENCE
    while not (ready := page.evaluate(READY)):
        if time.monotonic() > deadline:
            raise TimeoutError(f"the live page showed no map within {PATIENCE:g} s")
    return float(ready)


def _dragged(opened: "Browser", url: str, seconds: float) -> tuple[float, float, float]:
    """Frames a second of the page while it is dragged at a pixel a cell, s of work in one; a blank page's."""
    with _page(opened, f"{url}#16/0/0") as page:
        _once(page)
        devtools = page.context.new_cdp_session(page)
        devtools.send("Performance.enable")

        def worked() -> float:
            told = devtools.send("Performance.getMetrics")["metrics"]
            return next(float(one["value"]) for one in told if one["name"] == "TaskDuration")

        before = worked()
        ours = page.evaluate(DRAG, seconds)
        work = (worked() - before) / (ours * seconds)
    with _page(opened, "about:blank") as page:
        return ours, work, page.evaluate(DRAG, seconds)
