"""Takes the picture of the live page that README.md shows: `ogm demo` in the office, two thirds of a round.

Needs Chromium, which runs without a window, and two minutes: as long as the robot takes to get there.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

from ogm_client import MapClient
from ogm_core.errors import OgmError
from ogm_services.mapper.service import LIVE_MAP
from ogm_services.settings.sources import without_settings

PICTURE = Path(__file__).with_name("page.png")
SCANS = 2600
"""How many scans are in the map when the picture is taken."""
SIZE = 1100, 625
"""Of the window, pixels."""
COLOURS = 128
"""The page has few: a palette that covers them all makes its picture several times smaller."""
BROWSERS = "chromium", "chromium-browser", "google-chrome"
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
)
SETTLE_MS = 4000
"""Time of the page's own clock until the picture: it asks for the map twice a second."""
COMPLETE = ">live</span>", '<section id="quality">'
"""What the page's document says once all of it has been filled in."""
PATIENCE = 60.0
"""How long the robot may take beyond its 20 scans a second, and the browser, s."""


class NoPicture(OgmError):
    """No picture could be taken; the message says why and what to do."""

    slug = "no-picture"


def main() -> None:
    """Take the picture, or say in one line why not."""
    parser = argparse.ArgumentParser(prog="make page-picture", description=__doc__)
    parser.add_argument("--out", type=Path, default=PICTURE, help="file to write")
    parser.add_argument("--scans", type=int, default=SCANS, help="scans in the map when it is taken")
    arguments = parser.parse_args()
    try:
        take(arguments.out, arguments.scans)
    except OgmError as error:
        sys.exit(f"page-picture: {error}")


def take(out: Path, scans: int) -> None:
    """Write a picture of the live page, of a map with so many scans.

    Raises:
        NoPicture: there is no browser, it took no picture, or the demo failed.
        ClientError: the demo's mapper does not answer.
    """
    browser = found_browser()
    with tempfile.TemporaryDirectory(prefix="ogm-page-") as folder, running_demo() as (demo, url):
        wait_for(demo, url, scans)
        shot = Path(folder, "page.png")
        look_at(url, browser, shot, Path(folder, "profile"))
        with Image.open(shot) as picture:
            small = picture.convert("RGB").quantize(
                COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
            )
        small.save(out, optimize=True)


def found_browser() -> str:
    """Path of a Chromium."""
    for name in BROWSERS:
        if path := shutil.which(name):
            return path
    raise NoPicture(
        f"Chromium is not installed (none of {', '.join(BROWSERS)} on the path); Debian, Ubuntu: "
        "apt install chromium"
    )


@contextmanager
def running_demo() -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """A demo in the office on free ports, and the address of its live page; it ends with the `with`."""
    flags = "--world", "office", "--listen", "tcp/127.0.0.1:0", "--http-port", "0", "--log-level", "warning"
    demo = subprocess.Popen(
        [sys.executable, "-m", "ogm_services", "demo", *flags],
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


def look_at(url: str, browser: str, shot: Path, profile: Path) -> None:
    """Have the browser take a picture of the page, with a fresh profile, once the page shows everything."""
    flags = [
        *FLAGS,
        f"--user-data-dir={profile}",
        f"--window-size={SIZE[0]},{SIZE[1]}",
        f"--virtual-time-budget={SETTLE_MS}",
        f"--screenshot={shot}",
        "--dump-dom",
    ]
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        looked = subprocess.run(
            [browser, *flags, url], capture_output=True, text=True, timeout=PATIENCE, check=False
        )
        if looked.returncode or not shot.exists():
            said = looked.stderr.strip().splitlines()
            raise NoPicture(f"{browser} took no picture: {said[-1] if said else 'it said nothing'}")
        # The browser's clock for the page may run ahead of the mapper's answers.
        if all(text in looked.stdout for text in COMPLETE):
            return
    raise NoPicture(f"{url} did not show a live map and its figures within {PATIENCE:g} s")


if __name__ == "__main__":
    main()
