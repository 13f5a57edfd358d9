"""Chromium, driven by Playwright, and pages of the lab's map; `make test-web` installs what is needed."""

import os
import shutil
from pathlib import Path

import pytest

from page_desk import MapperProcess, WatchedPage, lap

SHOTS = Path(__file__).parents[2] / "build" / "web"
"""Folder of the pictures that are kept to be looked at."""
BROWSERS = "chromium", "chromium-browser", "google-chrome"
WIDE, PHONE = (1400, 900), (390, 844)


def _missing(reason):
    if os.environ.get("OGM_WEB_TESTS") == "require":
        pytest.fail(f"OGM_WEB_TESTS=require: {reason}")
    pytest.skip(reason)


@pytest.fixture(scope="session")
def chromium():
    """A browser without a window."""
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError:
        _missing("Playwright is not installed: make test-web installs it")
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is None:
        _missing("Chromium is not installed; Debian, Ubuntu: apt-get install -y chromium, as root")
    with sync_playwright() as playwright:
        flags = ["--no-sandbox", "--disable-dev-shm-usage"]
        browser = playwright.chromium.launch(executable_path=path, args=flags)
        yield browser
        browser.close()


@pytest.fixture
def mapper():
    """A mapper whose map is empty, with cells of 0.1 m."""
    made = MapperProcess("--resolution", "0.1")
    try:
        made.start()
        yield made
    finally:
        made.stop()


@pytest.fixture(scope="session")
def lab():
    """A mapper with a lap through the lab in its map, for tests that change nothing; its robot stands."""
    made = MapperProcess("--resolution", "0.1")
    try:
        made.start()
        with made.robot() as robot:
            for scan, *_ in lap():
                robot.put_scan("laser", scan)
            _wait_for(made, 220)
            yield made
    finally:
        made.stop()


def _wait_for(mapper, scans):
    import time

    deadline = time.monotonic() + 60.0
    while mapper.integrated() < scans:
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture
def look(chromium):
    """`look(mapper, size, **context)`: a watched page of a mapper; of `Browser.new_context`."""
    contexts = []

    def open_page(mapper, size=WIDE, **options):
        context = chromium.new_context(viewport={"width": size[0], "height": size[1]}, **options)
        contexts.append(context)
        context.set_default_timeout(30_000)
        return WatchedPage(context.new_page(), mapper.url)

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture
def phone():
    """Options of a page on a phone."""
    return {"size": PHONE, "has_touch": True, "is_mobile": True, "device_scale_factor": 2}


@pytest.fixture
def keep():
    """`keep(watched, name)`: a picture of the page, to be looked at."""

    def shoot(watched, name):
        SHOTS.mkdir(parents=True, exist_ok=True)
        watched.page.screenshot(path=SHOTS / f"{name}.png")

    return shoot
