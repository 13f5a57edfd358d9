"""The live page loads: live, with tiles, without a word of complaint, and asks nobody but the mapper."""

import re

import pytest

from page_desk import lap

DRAWN = "() => [...ogm.tiles.held.values()].filter((tile) => tile.bitmap).length"


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("device", ["desk", "phone"])
def test_it_is_live_and_complains_of_nothing(lab, look, phone, keep, scheme, device):
    watched = look(lab, color_scheme=scheme, **(phone if device == "phone" else {}))
    watched.open()
    page = watched.page
    assert page.get_by_role("heading", level=1).text_content() == "zenoh-ogm default"
    assert watched.state() == ("", "live")
    assert page.evaluate(DRAWN) >= 1
    assert page.locator("#palette").input_value() == {"light": "ros", "dark": "dark"}[scheme]
    # All of the map is in view.
    for corner in [(-10.0, -10.0), (10.0, 10.0)]:
        box = page.locator("#map").bounding_box()
        u, v = watched.place(*corner)
        assert box["x"] < u < box["x"] + box["width"]
        assert box["y"] < v < box["y"] + box["height"]
    # No page is wider than its window.
    assert page.evaluate("() => document.documentElement.scrollWidth <= innerWidth")
    keep(watched, f"lab-{device}-{scheme}")
    assert watched.complaints == []


def test_a_map_without_a_cell_waits_for_one_and_shows_it(mapper, look, keep, eventually):
    watched = look(mapper)
    watched.page.goto(mapper.url)
    eventually(lambda: watched.state() == ("wait", "waiting for the first scan"))
    empty = watched.page.locator("#empty")
    assert empty.inner_text().startswith("Nothing to see yet")
    title, state = (watched.page.locator(f"#panel {part}").bounding_box() for part in ("h1", "#state"))
    assert title["height"] < 30  # one line, with room beside it
    assert state["y"] >= title["y"] + title["height"]
    keep(watched, "empty")
    with mapper.robot() as robot:
        robot.publish_scan(
            [1.0], angle_min=0.0, angle_increment=0.1, range_min=0.5, range_max=2.0, pose=(0.05, 0.05, 0.0)
        )
        eventually(lambda: mapper.integrated() == 1)
        watched.settle()
        assert empty.is_hidden()
    keep(watched, "one-beam")
    assert watched.complaints == []


def test_it_follows_nobody_elsewhere_and_needs_no_script_of_its_document(lab):
    document = lab.get("")
    assert not re.search(r"<script(?![^>]*src=)|\son\w+=|javascript:|style=", document.text)
    assert "'unsafe-eval'" not in document.headers["content-security-policy"]
    assert len(lap()) == 220
