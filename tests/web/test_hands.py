"""What hands do: keys, mouse and fingers move the view, measure, follow, link, copy and save."""

import re

import numpy as np
import pytest
from PIL import Image

from page_desk import lap, module

VIEW = "() => { const {lat, lng} = ogm.view.map.getCenter(); return [lng, lat, ogm.view.map.getZoom()]; }"


def view(watched):
    """Where the middle of the view is, m, and its zoom."""
    return watched.page.evaluate(VIEW)


def address(page):
    """Of the page, as its window shows it."""
    return page.evaluate("() => location.href")


def first_line(page):
    """Of the readout; nothing where it is empty."""
    return "".join(page.locator("#place div").all_text_contents()[:1])


def linked(page):
    """The x and y in its address."""
    return [float(part) for part in address(page).split("/")[-2:]]


@pytest.fixture
def watched(lab, look):
    """The lab's page."""
    made = look(lab)
    made.open()
    yield made
    assert made.complaints == []


def test_the_wheel_zooms_at_the_pointer_and_dragging_moves_what_is_held(lab, look, eventually):
    # Else what is let go while it moves moves on.
    watched = look(lab, reduced_motion="reduce")
    watched.open()
    page, spot = watched.page, (4.0, -3.0)
    x, y = watched.place(*spot)
    before = view(watched)[2]
    page.mouse.move(x, y)
    page.mouse.wheel(0, -300)
    eventually(lambda: view(watched)[2] > before)
    watched.settle()
    assert watched.place(*spot) == pytest.approx((x, y), abs=3)
    page.mouse.down()
    page.mouse.move(x + 40, y + 10)
    page.mouse.move(x + 120, y - 60)
    page.mouse.up()
    eventually(lambda: watched.place(*spot) == pytest.approx((x + 120, y - 60), abs=4))
    watched.settle()
    assert watched.complaints == []


def test_keys_move_the_view(watched, eventually):
    page = watched.page
    page.locator("#map").focus()
    x, y, zoom = view(watched)
    page.keyboard.press("+")
    eventually(lambda: view(watched)[2] == zoom + 1)
    page.keyboard.press("-")
    eventually(lambda: view(watched)[2] == zoom)
    page.keyboard.press("ArrowRight")
    eventually(lambda: view(watched)[0] > x + 1)
    # While the view moves another arrow says nothing.
    eventually(lambda: page.keyboard.press("ArrowUp") or view(watched)[1] > y + 1)
    page.keyboard.press("f")
    eventually(lambda: view(watched) == pytest.approx([x, y, zoom]))
    page.keyboard.press("g")
    assert page.get_by_role("button", name="grid in metres").get_attribute("aria-pressed") == "true"
    # Without a pointer the readout says what is in the middle of the view.
    middle = pytest.approx(view(watched)[:2], abs=0.011)
    eventually(lambda: [float(part) for part in re.findall(r"-?\d+\.\d\d", first_line(page))] == middle)


def test_two_fingers_zoom_the_map_and_not_the_page(lab, look, phone, eventually):
    watched = look(lab, **phone)
    watched.open()
    page, zoom = watched.page, view(watched)[2]
    client = page.context.new_cdp_session(page)
    u, v = watched.place(0.0, 0.0)

    def touch(kind, apart):
        points = [] if kind == "touchEnd" else [{"x": u - apart, "y": v}, {"x": u + apart, "y": v}]
        client.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 30)
    for apart in range(35, 121, 5):
        touch("touchMove", apart)
    touch("touchEnd", 0)
    eventually(lambda: zoom + 1.5 <= view(watched)[2] <= zoom + 2.5)
    assert page.evaluate("() => visualViewport.scale") == 1
    assert watched.place(0.0, 0.0) == pytest.approx((u, v), abs=12)
    # Fingers hit what they aim at.
    for button in page.locator("#tools button:visible").all():
        box = button.bounding_box()
        assert min(box["width"], box["height"]) >= 43.9
    watched.settle()
    assert watched.complaints == []


def test_a_phone_that_lies_has_all_buttons_in_sight_and_turned_its_map(lab, look, phone, keep, eventually):
    watched = look(lab, **{**phone, "size": phone["size"][::-1]})
    watched.open()
    height = watched.page.evaluate("() => innerHeight")
    boxes = [button.bounding_box() for button in watched.page.locator("#tools button:visible").all()]
    assert len(boxes) == 8
    assert min(min(box["width"], box["height"]) for box in boxes) >= 41.9
    # The scale is legible below them.
    assert max(box["y"] + box["height"] for box in boxes) <= height - 36
    keep(watched, "lab-phone-lying")
    sections = watched.page.locator("#sections")
    assert sections.is_visible()
    width, height = phone["size"]
    watched.page.set_viewport_size({"width": width, "height": height})
    eventually(sections.is_hidden)
    watched.page.set_viewport_size({"width": height, "height": width})
    eventually(sections.is_visible)
    assert watched.complaints == []


def test_measuring_three_four_five(watched, eventually):
    page = watched.page
    page.keyboard.press("m")
    for point in [(0.0, 0.0), (3.0, 0.0), (3.0, 4.0), (0.0, 0.0)]:
        page.mouse.click(*watched.place(*point))
    script = f"async () => (await {module('measure')}).measured()"
    assert page.evaluate(script) == pytest.approx(12.0, abs=0.1)
    page.keyboard.press("Escape")
    assert page.evaluate(script) == 0
    assert page.evaluate("() => ogm.state.tool") is None


def test_a_clicked_point_is_copied(watched, eventually):
    page = watched.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.mouse.click(*watched.place(1.0, 2.0))
    page.get_by_role("button", name="copy", exact=True).click()
    copied = eventually(lambda: page.evaluate("() => navigator.clipboard.readText()"))
    assert [float(part) for part in copied.split(", ")] == pytest.approx([1.0, 2.0], abs=0.06)
    assert page.locator("#notice").inner_text() == f"Copied: {copied} m."
    page.keyboard.press("Escape")
    eventually(page.locator("#pin").is_hidden)


def test_a_link_leads_to_the_same_view(watched, lab, look, eventually):
    page = watched.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    watched.page.mouse.move(*watched.place(0.0, 0.0))
    page.mouse.wheel(0, -200)
    eventually(lambda: address(page).count("/") == 5)
    page.locator("#map").focus()
    x = view(watched)[0]
    page.keyboard.press("ArrowLeft")
    # The view glides; its address is the one where it stands still.
    eventually(
        lambda: view(watched)[0] < x - 0.5 and linked(page) == pytest.approx(view(watched)[:2], abs=0.011)
    )
    watched.settle()
    page.keyboard.press("l")
    link = eventually(lambda: page.evaluate("() => navigator.clipboard.readText()"))
    assert link == address(page)
    assert page.locator("#notice").inner_text() == "Copied: a link to this view."
    other = look(lab)
    other.open("#" + link.partition("#")[2])
    assert view(other) == pytest.approx(view(watched), abs=0.011)
    # It stays there while the map is fitted by nobody.
    for nonsense in ("#16/0", "#99/0/0", "#a/b/c"):
        third = look(lab)
        third.open(nonsense)
        assert third.complaints == []


def test_a_view_that_is_fitted_has_no_address_and_a_link_all_the_same(watched, lab, eventually):
    page = watched.page
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    fitted = view(watched)
    watched.page.mouse.move(*watched.place(3.0, 2.0))
    page.mouse.wheel(0, -300)
    eventually(lambda: "#" in address(page))
    page.keyboard.press("f")
    eventually(lambda: address(page) == lab.url)
    page.keyboard.press("l")
    link = eventually(lambda: page.evaluate("() => navigator.clipboard.readText()"))
    z, x, y = (float(part) for part in link.partition("#")[2].split("/"))
    assert [x, y, z - 16] == pytest.approx(fitted, abs=0.011)


def test_what_is_seen_is_saved_as_a_picture(watched, tmp_path):
    with watched.page.expect_download() as saving:
        watched.page.keyboard.press("p")
    assert re.fullmatch(r"default-\d+\.png", saving.value.suggested_filename)
    saving.value.save_as(tmp_path / "map.png")
    saved = np.asarray(Image.open(tmp_path / "map.png").convert("RGB"))
    shown = watched.page.evaluate("() => [ogm.canvas.canvas.width, ogm.canvas.canvas.height]")
    assert saved.shape == (shown[1], shown[0], 3)
    # What is transparent on the page has the ground's colour there.
    assert (saved[2, 2] == 0xCD).all()
    assert (saved == 0xFE).all(axis=2).mean() > 0.3


def test_a_followed_robot_stays_in_the_middle(mapper, look, eventually):
    watched = look(mapper)
    with mapper.robot() as robot:
        mapper.drive(robot, lap()[:1], eventually)
        watched.open()
        watched.page.keyboard.press("r")
        for placed in lap()[20:60:20]:
            mapper.drive(robot, [placed], eventually)
            middle = pytest.approx(placed.pose[:2], abs=0.06)
            eventually(lambda wanted=middle: view(watched)[:2] == wanted)
        assert watched.page.evaluate("() => ogm.state.followed") == "robot1"
        u, v = watched.place(0.0, 0.0)
        watched.page.mouse.move(u, v)
        watched.page.mouse.down()
        watched.page.mouse.move(u + 50, v + 20)
        watched.page.mouse.move(u + 90, v + 40)
        watched.page.mouse.up()
        eventually(lambda: watched.page.evaluate("() => ogm.state.followed") is None)
    assert watched.complaints == []


def test_who_wants_little_motion_gets_none(lab, look):
    watched = look(lab, reduced_motion="reduce")
    watched.open()
    watched.page.locator("#map").focus()
    x = view(watched)[0]
    moved = watched.page.evaluate(
        """() => {
          const pressed = new KeyboardEvent("keydown", {key: "ArrowRight", keyCode: 39, bubbles: true});
          document.getElementById("map").dispatchEvent(pressed);
          return ogm.view.map.getCenter().lng;
        }"""
    )
    assert moved > x + 1  # at once
    assert watched.page.evaluate("() => ogm.view.map.options.inertia") is False


def test_a_screen_reader_hears_what_the_map_is_and_which_keys_it_has(watched):
    page = watched.page
    said = page.locator("#view").aria_snapshot()
    assert '- application "the map, north up"' in said
    for name in (
        "zoom in",
        "fit the walls",
        "fit all of the map",
        "follow the next robot",
        "measure",
        "full screen",
    ):
        assert f'- button "{name}"' in said
    described = page.locator("#map").get_attribute("aria-describedby")
    keys = page.locator(f"#{described}").text_content()
    for key in re.findall(r'aria-keyshortcuts="(.)"', page.locator("#tools").inner_html()):
        assert re.search(rf"(?<!\w){re.escape(key)}(?!\w)", keys), key
