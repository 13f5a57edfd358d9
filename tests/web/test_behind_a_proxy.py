"""The live page behind a reverse proxy under a path: it is live, writes, and asks for nothing elsewhere."""

from urllib.parse import urlsplit

import pytest

from page_desk import MapperProcess, WatchedPage
from small_proxy import small_proxy

PREFIX = "/robots/hall"
TOKEN = "the-token-of-these-tests"
ONE_BEAM = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 8.0}


@pytest.fixture(params=[True, False], ids=["strips", "does not strip"])
def proxied(request, tmp_path):
    """A mapper with a token, and its page's address at a proxy that strips the path, or does not."""
    token = tmp_path / "token"
    token.write_text(TOKEN)
    token.chmod(0o600)
    mapper = MapperProcess("--resolution", "0.1", "--http-token-file", str(token), "--root-path", PREFIX)
    try:
        mapper.start()
        with mapper.robot() as robot:
            robot.publish_scan([2.05], **ONE_BEAM, pose=(0.05, 0.05, 0.0))
        with small_proxy(urlsplit(mapper.url).netloc, PREFIX, strips=request.param) as address:
            yield mapper, f"http://{address}{PREFIX}/"
    finally:
        mapper.stop()


def test_it_is_live_and_erases(proxied, chromium, eventually):
    mapper, url = proxied
    context = chromium.new_context(viewport={"width": 1400, "height": 900})
    try:
        watched = WatchedPage(context.new_page(), url)
        asked = []
        watched.page.on("request", lambda request: asked.append(request.url))
        watched.open()
        page = watched.page
        page.evaluate("() => { ogm.state.layers.scans.shown = false; }")  # it is drawn over its hit
        watched.show(1.0, 0.0, 3)
        assert watched.colour(2.05, 0.05) == "#000000"
        assert len(asked) > 10
        assert [found for found in asked if not found.startswith(url)] == []
        for link in page.locator("a[href]").all():
            assert link.evaluate("(it) => it.href").startswith(url)

        page.get_by_text("Change the map").click()
        page.get_by_role("button", name="Erase an area").click()
        for corner in ((1.98, -0.5), (2.5, -0.5), (2.5, 0.5), (1.98, 0.5)):
            page.mouse.click(*watched.place(*corner))
        page.keyboard.press("Enter")
        page.get_by_role("button", name="Erase", exact=True).click()
        page.get_by_label("token", exact=True).fill(TOKEN)
        page.keyboard.press("Enter")
        eventually(lambda: page.locator("#notice").inner_text() == "Erased 1 known cell.")
        (cookie,) = context.cookies()
        assert cookie["path"] == PREFIX
        assert mapper.get("status").json()["revision"] == 2
    finally:
        context.close()
