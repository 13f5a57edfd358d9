"""The live page's panel: robots and what keeps their scans out of the map, figures, layers; its banner."""

import json
import os
import signal

import pytest

ORANGE = [0x8A, 0x3B, 0x00]
"""What is wrong with a robot is written so on the map, where its ground is light."""
FAR = (1e6, 0.0, 0.0)
"""A scan from there would stretch the map past its limits."""
ONE_BEAM = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 8.0}
IS_DRAWN = """(wanted) => {
  const {canvas} = ogm.canvas, {width, height} = canvas;
  const {data} = canvas.getContext("2d").getImageData(0, 0, width, height);
  const isThere = (at) => wanted.every((part, k) => data[at + k] === part);
  for (let at = 0; at < data.length; at += 4) if (isThere(at)) return true;
  return false;
}"""
TABBED = """() => {
  const at = document.activeElement, whole = at.closest("label, summary, a, button");
  return (at.id || at.getAttribute("aria-label") || whole?.textContent || "").trim();
}"""
OPEN_ALL = """() => { for (const each of document.querySelectorAll("details")) each.open = true; }"""
TOO_SMALL = """() => [...document.querySelectorAll("#panel :is(button, summary, a, select, label)")]
  .filter((each) => each.checkVisibility())
  .map((each) => [each.outerHTML.slice(0, 80), each.getBoundingClientRect()])
  .map(([html, {width, height}]) => [html, width, height])
  .filter(([, width, height]) => width < 44 || height < 43.5)"""
PALE = """() => {
  const channels = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const linear = (part) => part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  const light = (colour) => channels(colour).slice(0, 3)
    .reduce((sum, part, k) => sum + linear(part / 255) * [0.2126, 0.7152, 0.0722][k], 0);
  const solid = (colour) => (channels(colour)[3] ?? 1) > 0.9;
  const pale = [];
  for (const each of document.querySelectorAll("body *")) {
    const written = [...each.childNodes].some((node) => node.nodeType === Node.TEXT_NODE && node.data.trim());
    if (!written || !each.checkVisibility() || each.matches(":disabled, option")) continue;
    let behind = each;
    while (behind !== document.body && !solid(getComputedStyle(behind).backgroundColor)) {
      behind = behind.parentElement;
    }
    const both = [getComputedStyle(each).color, getComputedStyle(behind).backgroundColor].map(light);
    const contrast = (Math.max(...both) + 0.05) / (Math.min(...both) + 0.05);
    if (contrast < 4.5) pale.push([each.outerHTML.slice(0, 80), contrast]);
  }
  return pale;
}"""


def card(page, name):
    """A robot's card."""
    return page.locator("#robots li").filter(has=page.get_by_role("button", name=name, exact=True))


def test_a_robot_is_said_to_be_kept_out_of_the_map_where_it_is(mapper, look, keep, eventually):
    watched = look(mapper)
    with mapper.robot("good") as good, mapper.robot("far") as far:
        good.publish_scan([1.0], **ONE_BEAM, pose=(0.0, 0.0, 0.0))
        far.publish_scan([1.0], **ONE_BEAM, pose=(3.0, 1.0, 0.0))
        watched.open()
        page = watched.page
        assert card(page, "far").locator("details").is_hidden()

        def written():
            far.publish_scan([1.0], **ONE_BEAM, pose=FAR)
            far.publish_pose(3.0, 1.0, 0.0)
            return page.evaluate(IS_DRAWN, ORANGE)

        assert not page.evaluate(IS_DRAWN, ORANGE)
        eventually(written)
        trouble = card(page, "far").locator("details.now")
        summary = trouble.locator("summary")
        assert summary.text_content().endswith(" not in the map: limit")
        assert trouble.locator("dd").is_hidden()
        summary.focus()
        page.keyboard.press("Enter")
        assert trouble.locator("dd").inner_text() == (
            "they would stretch the map past its limits: are their poses and ranges right?"
        )
        assert card(page, "good").locator("details").is_hidden()
        keep(watched, "trouble")
        card(page, "far").get_by_role("button").click()
        eventually(lambda: card(page, "far").locator(".heard").text_content() == "followed")
        assert page.evaluate("() => ogm.state.followed") == "far"
    eventually(lambda: card(page, "far").get_attribute("class") == "silent")
    assert card(page, "far").locator(".heard").text_content().startswith("silent ")


def test_a_robot_has_the_colour_that_it_has_on_the_map(lab, look):
    watched = look(lab)
    watched.open()
    key = watched.page.locator("#robots .key")
    colour = tuple(json.loads(f"[{key.evaluate('(it) => getComputedStyle(it).backgroundColor')[4:-1]}]"))
    x, y, _ = lab.get("status").json()["robots"]["robot1"]["pose"]
    watched.show(x, y, 3)
    red, green, blue = (int(watched.colour(x, y)[at : at + 2], 16) for at in (1, 3, 5))
    assert (red, green, blue) == colour


def test_layers_are_switched_made_fainter_and_remembered(lab, look):
    watched = look(lab)
    watched.open()
    page, wall = watched.page, (10.05, 0.05)
    layer = page.locator("#layers").get_by_label("map", exact=True)
    assert watched.colour(*wall) == "#000000"
    page.get_by_label("opacity of map").fill("0.5")
    watched.settle()
    assert page.evaluate("() => ogm.state.layers.map") == {"shown": True, "opacity": 0.5}
    layer.uncheck()
    watched.settle()
    assert watched.colour(*wall) == "transparent"
    grid = page.locator("#layers").get_by_label("grid lines", exact=True)
    assert not grid.is_checked()
    page.locator("#map").focus()
    page.keyboard.press("g")
    assert grid.is_checked()
    page.reload()
    watched.settle()
    assert (layer.is_checked(), grid.is_checked()) == (False, True)
    assert page.get_by_label("opacity of map").input_value() == "0.5"
    layer.check()
    watched.settle()
    assert watched.colour(*wall) == "#000000"


def test_curves_are_looked_at_by_keys(lab, look):
    watched = look(lab)
    series = {"stamp": [0, 60e9, 240e9], "revision": [1, 2, 10**6], "entropy_bits": [1.0, 1.0, 1.0]}
    series |= {"mean_entropy_bits": [0.5, 0.25, 0.125], "known_m2": [10.0, 20.0, 40.0]}
    series["hit"] = [None, 0.5, 0.75]
    told = {**lab.get("quality").json(), "series": series, "truth": None, "free_m2": 12.34}
    watched.page.route("**/quality", lambda route: route.fulfill(json=told))
    watched.open()
    page = watched.page

    def shown():
        return [text.strip() for text in page.locator("#since, .spark figcaption").all_text_contents()]

    assert page.locator("#figures").inner_text().splitlines()[0] == "free\t12.3 m²"
    assert page.locator("#truth").is_hidden()
    at_the_end = [
        "after 4.0 min",
        "known area40.0 m²",
        "mean entropy0.125 bits",
        "beams that the map predicts75.0 %",
    ]
    assert shown() == at_the_end
    page.locator("#curves").focus()
    page.keyboard.press("ArrowLeft")
    assert shown() == [
        "after 60 s",
        "known area20.0 m²",
        "mean entropy0.250 bits",
        "beams that the map predicts50.0 %",
    ]
    for _ in range(40):
        page.keyboard.press("ArrowLeft")
    assert shown() == [
        "after 0 s",
        "known area10.0 m²",
        "mean entropy0.500 bits",
        "beams that the map predictsnone",
    ]
    page.keyboard.press("Tab")
    assert shown() == at_the_end
    name = page.get_by_role("img", name="known area").get_attribute("aria-label")
    assert name == "known area: 10.0 m² at first, 40.0 m² now"


def test_a_banner_says_that_a_mapper_is_gone_or_hangs_and_goes_by_itself(mapper, look, keep, eventually):
    watched = look(mapper)
    with mapper.robot() as robot:
        robot.publish_scan([1.0], **ONE_BEAM, pose=(0.0, 0.0, 0.0))
        watched.open()
    page = watched.page
    banner = page.get_by_role("alert")
    assert banner.count() == 0
    os.kill(mapper.process.pid, signal.SIGSTOP)
    try:
        eventually(banner.is_visible)
        assert banner.text_content().startswith("Nothing from the mapper since ")
        assert watched.state() == ("bad", "no answer from the mapper")
        keep(watched, "banner")
        below = banner.bounding_box()
        assert page.locator("#tools").bounding_box()["y"] >= below["y"] + below["height"]
    finally:
        os.kill(mapper.process.pid, signal.SIGCONT)
    eventually(lambda: not banner.is_visible())
    mapper.kill()
    eventually(banner.is_visible)
    mapper.start()
    eventually(lambda: not banner.is_visible())
    eventually(lambda: watched.state() == ("wait", "waiting for the first scan"))
    assert (
        page.locator("#notice").inner_text() == "Another map: it was emptied, or one that was saved is shown."
    )


def test_parts_that_are_missing_are_named_and_grey_and_a_disk_that_fails_is_told(lab, look, eventually):
    watched = look(lab)
    told = {
        **lab.get("status").json(),
        "missing": [{"share": "3", "bounds": [-4.0, -4.0, 0.0, 4.0], "since": None}],
        "store": {"revision": 7, "failing": "no space left", "bytes": 10},
    }
    watched.page.route("**/status", lambda route: route.fulfill(json=told))
    watched.open()
    page = watched.page
    banner = page.get_by_role("alert")
    eventually(banner.is_visible)
    assert banner.text_content() == "The map is not stored at present: no space left"
    assert page.locator("#parts").inner_text() == "share 3\tno answer"
    page.get_by_label("last scans", exact=True).uncheck()
    watched.settle()
    assert watched.colour(0.95, -3.05) == "#fefefe"
    assert watched.colour(-1.05, -3.05) not in ("#fefefe", "transparent")
    page.get_by_text("Figures", exact=False).first.click()
    assert "stored\trevision 7" in page.locator("#facts").inner_text().splitlines()


def test_a_part_that_is_missing_reaches_to_the_edge_of_the_view_where_it_is_open(lab, look, eventually, keep):
    watched = look(lab)
    parts = [{"share": 3, "bounds": [None, None, 0.0, None], "since": 1_700_000_000_000_000_000}]
    told = {**lab.get("status").json(), "missing": parts}
    watched.page.route("**/status", lambda route: route.fulfill(json=told))
    watched.open()
    page = watched.page
    eventually(page.get_by_role("alert").is_visible)
    assert "share 3 does not answer" in page.get_by_role("alert").text_content()
    page.get_by_label("last scans", exact=True).uncheck()
    watched.settle()
    assert watched.colour(0.95, -3.05) == "#fefefe"
    grey = watched.colour(-1.05, -6.05)
    assert grey not in ("#fefefe", "transparent")
    keep(watched, "missing")
    parts.clear()
    eventually(lambda: watched.colour(-1.05, -6.05) == "#fefefe")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_what_is_written_is_easy_to_read(lab, look, scheme):
    watched = look(lab, color_scheme=scheme)
    watched.open()
    watched.page.evaluate(OPEN_ALL)
    watched.page.get_by_role("button", name="Erase an area").click()
    assert watched.page.evaluate(PALE) == []


def test_keys_reach_everything(lab, look):
    watched = look(lab)
    watched.open()
    page = watched.page
    reached = []
    page.locator("#map").focus()
    for _ in range(60):
        reached.append(page.evaluate(TABBED))
        page.keyboard.press("Tab")
    wanted = ["map", "follow the next robot", "Robots", "robot1", "How it settles", "curves", "Layers"]
    wanted += ["grid lines", "opacity of trails", "palette", "Change the map", "Figures", "Download"]
    assert [name for name in wanted if not any(each.startswith(name) for each in reached)] == []


def test_on_a_phone_the_panel_is_a_sheet_for_thumbs(lab, look, phone, keep):
    watched = look(lab, **phone)
    watched.open()
    page = watched.page
    grip = page.locator("#grip")
    assert grip.get_attribute("aria-expanded") == "false"
    assert page.locator("#sections").is_hidden()
    box = page.locator("#map").bounding_box()
    assert box["height"] > 700
    grip.tap()
    assert grip.get_attribute("aria-expanded") == "true"
    page.evaluate(OPEN_ALL)
    assert page.evaluate(TOO_SMALL) == []
    assert page.locator("#map").bounding_box() == box
    keep(watched, "sheet")
    assert watched.complaints == []
