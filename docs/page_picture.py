"""Takes the pictures of the live page that README.md and docs show: `ogm demo` in the office and in the lab.

Each is taken light and dark. It needs Chromium, which runs without a window, Playwright (the extra
`web-test`), and three minutes: as long as the robot takes to get there.
"""

import argparse
import io
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ogm_client import MapClient
from ogm_core.errors import OgmError
from ogm_services.mapper.service import LIVE_MAP
from ogm_services.settings.sources import without_settings

FOLDER = Path(__file__).parent
SCANS = {"office": 2600, "lab": 420}
"""How many scans are in the map when its pictures are taken, by world."""
NAMES = {("office", "light"): "page.png", ("office", "dark"): "page-dark.png"}
NAMES |= {("lab", "light"): "page-lab.png", ("lab", "dark"): "page-lab-dark.png"}
BEGUN = 100
"""How many are in it when the pages are opened: a browser that starts keeps a mapper from its first ones."""
SIZE = 1100, 625
"""Of the window, pixels."""
COLOURS = 256
"""The page has few, but for the edges of letters: those that it has most of make its picture smaller."""
BROWSERS = "chromium", "chromium-browser", "google-chrome"
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars"]
SETTLED = """() => {
  const text = (id) => document.getElementById(id)?.textContent ?? "";
  const {tiles} = globalThis.ogm ?? {};
  return text("state") === "live" && text("now").includes("scans/s") && text("figures") !== ""
    && tiles?.held.size > 0 && tiles.asking.size === 0;
}"""
"""Whether the page shows everything: it fills in what it is told, which takes it a few seconds."""
PATIENCE = 60.0
"""How long the robot may take beyond its 20 scans a second, and the page, s."""


class NoPicture(OgmError):
    """No picture could be taken; the message says why and what to do."""

    slug = "no-picture"


def main() -> None:
    """Take the pictures, or say in one line why not."""
    parser = argparse.ArgumentParser(prog="make page-picture", description=__doc__)
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder to write them into")
    parser.add_argument("--world", choices=SCANS, help="this one alone")
    parser.add_argument("--scans", type=int, help="scans in the map when they are taken")
    arguments = parser.parse_args()
    worlds = [arguments.world] if arguments.world else list(SCANS)
    try:
        for world in worlds:
            take(arguments.out, world, arguments.scans or SCANS[world])
    except OgmError as error:
        sys.exit(f"page-picture: {error}")


def take(out: Path, world: str, scans: int) -> None:
    """Write the pictures of the live page, light and dark, of a map of this world with so many scans.

    Raises:
        NoPicture: there is no browser, it took no picture, or the demo failed.
        ClientError: the demo's mapper does not answer.
    """
    with running_browser() as browser, running_demo(world) as (demo, url):
        wait_for(demo, url, min(scans, BEGUN))
        # They are open all the while: trails are those of the page.
        pages = {name: opened(url, browser, scheme) for (of, scheme), name in NAMES.items() if of == world}
        wait_for(demo, url, scans)
        for name, page in pages.items():
            with Image.open(io.BytesIO(look_at(page))) as picture:
                in_few_colours(picture.convert("RGB")).save(out / name, optimize=True)


def in_few_colours(picture: Image.Image) -> Image.Image:
    """A picture with the colours alone that it has most of; the others become the nearest of these."""
    pixels = np.asarray(picture, np.int64)
    colours, which, counts = np.unique(pixels.reshape(-1, 3), axis=0, return_inverse=True, return_counts=True)
    kept = colours[np.argsort(-counts, kind="stable")[:COLOURS]]
    nearest = np.argmin(np.sum((colours[:, None] - kept) ** 2, axis=2), axis=1).astype(np.uint8)
    small = Image.fromarray(nearest[which].reshape(pixels.shape[:2]))
    small.putpalette(kept.astype(np.uint8).tobytes())
    return small


@contextmanager
def running_browser() -> Iterator[Any]:
    """A Chromium of Playwright's; it ends with the `with`."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        raise NoPicture(
            f"Chromium is not installed (none of {', '.join(BROWSERS)} on the path); Debian, Ubuntu: "
            "apt install chromium"
        )
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        raise NoPicture("Playwright is not installed: pip install '.[web-test]'") from None
    with sync_playwright() as playwright:
        try:
            browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        except Error as error:
            said = error.message.strip().splitlines()
            raise NoPicture(f"{program} does not start: {said[0]}") from error
        with browser:
            yield browser


@contextmanager
def running_demo(world: str) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A demo in this world on free ports, and the address of its live page; it ends with the `with`."""
    flags = "--world", world, "--listen", "tcp/127.0.0.1:0", "--http-port", "0", "--log-level", "warning"
    demo = subprocess.Popen(
        [sys.executable, "-m", "ogm_services", "demo", "--map", world, *flags],
        env=without_settings(os.environ),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert demo.stdout is not None
        said = next((line for line in demo.stdout if line.startswith(LIVE_MAP)), None)
        if said is None:
            raise NoPicture(f"the demo ended with exit code {demo.wait()}")
        yield demo, said.removeprefix(LIVE_MAP).strip()
    finally:
        demo.terminate()
        demo.communicate()


def wait_for(demo: "subprocess.Popen[str]", url: str, scans: int) -> None:
    """Wait until the map holds so many scans."""
    deadline = time.monotonic() + scans / 20 + PATIENCE
    with MapClient(url.rstrip("/")) as mapper:
        while mapper.status().scans.integrated < scans:
            if demo.poll() is not None or time.monotonic() > deadline:
                raise NoPicture(f"the demo did not get as far as {scans} scans: see what it printed")
            time.sleep(0.1)


def opened(url: str, browser: Any, scheme: str) -> Any:  # noqa: ANN401 (Playwright may not be there)
    """The live page in the browser, where nothing is kept of before."""
    width, height = SIZE
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    page.goto(url)
    return page


def look_at(page: Any) -> bytes:  # noqa: ANN401
    """A picture of the page, once it shows everything."""
    deadline = time.monotonic() + PATIENCE
    while not page.evaluate(SETTLED):
        if time.monotonic() > deadline:
            raise NoPicture(f"{page.url} did not show a live map and its figures within {PATIENCE:g} s")
        page.wait_for_timeout(50)
    taken: bytes = page.screenshot()
    return taken


if __name__ == "__main__":
    main()
