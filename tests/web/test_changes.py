"""Changes of the map from the live page: an area is erased, the map saved and emptied, with a token."""

import pytest

from page_desk import MapperProcess

TOKEN = "the-token-of-these-tests"
ONE_BEAM = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 8.0}
AT_A_HIT, FREE = (2.05, 0.05), (1.05, 0.05)
NO_SCANS = "() => { ogm.state.layers.scans.shown = false; }"
"""The last scan is drawn over its hit."""
LOGGED = "an answer of 401 is an error on the console, too"


@pytest.fixture
def changed(look, eventually):
    """`changed(*flags)`: a mapper of one beam, from (0, 0) to a hit at x = 2, and its page."""
    made = []

    def open_page(*flags, **options):
        mapper = MapperProcess("--resolution", "0.1", *flags)
        made.append(mapper)
        mapper.start()
        with mapper.robot() as robot:
            robot.publish_scan([2.05], **ONE_BEAM, pose=(0.05, 0.05, 0.0))
            robot.wait_for_mapper()
        eventually(lambda: known(mapper) > 0)  # they are counted once a second
        watched = look(mapper, **options)
        watched.open()
        watched.page.evaluate("() => { document.querySelector('#changes').open = true; }")
        watched.page.evaluate(NO_SCANS)
        watched.show(1.0, 0.0, 3)
        return mapper, watched

    yield open_page
    for mapper in made:
        mapper.stop()


@pytest.fixture
def token_file(tmp_path):
    path = tmp_path / "token"
    path.write_text(TOKEN)
    path.chmod(0o600)
    return path


def known(mapper):
    """How many cells are known."""
    return mapper.get("status").json()["map_info"]["known_cells"]


def draw(watched, *corners):
    """Begin an area, and click its corners."""
    watched.page.get_by_role("button", name="Erase an area").click()
    for corner in corners:
        watched.page.mouse.click(*watched.place(*corner))


AROUND_THE_HIT = (1.98, -0.5), (2.5, -0.5), (2.5, 0.5), (1.98, 0.5)


def test_an_area_is_erased_with_a_token_that_is_asked_for_once(changed, token_file, keep, eventually):
    mapper, watched = changed("--http-token-file", str(token_file))
    page = watched.page
    before = known(mapper)
    assert watched.colour(*AT_A_HIT) == "#000000"
    assert page.get_by_role("button", name="Log out").is_hidden()
    draw(watched, *AROUND_THE_HIT)
    page.keyboard.press("Enter")
    keep(watched, "erasing")
    page.get_by_role("button", name="Erase", exact=True).click()
    token = page.get_by_label("token", exact=True)
    assert token.get_attribute("type") == "password"
    token.fill("another-than-the-one-of-these")
    page.keyboard.press("Enter")
    eventually(lambda: page.get_by_role("alert").inner_text() == "That is not the mapper's token.")
    keep(watched, "wrong-token")
    assert known(mapper) == before
    assert sum("401" in said for said in watched.complaints) == len(watched.complaints) == 2, LOGGED
    token.fill(TOKEN)
    page.keyboard.press("Enter")
    notice = page.locator("#notice")
    eventually(lambda: notice.inner_text() == "Erased 1 known cell.")
    assert page.locator("dialog, #ask:visible").count() == 0
    watched.settle()
    assert watched.colour(*AT_A_HIT) == "transparent"
    assert watched.colour(*FREE) == "#cdcdcd"
    eventually(lambda: known(mapper) == before - 1)

    draw(watched, (0.9, -0.5), (1.19, -0.5), (1.19, 0.5), (0.9, 0.5))
    page.get_by_role("button", name="Done").click()
    page.get_by_role("button", name="Erase", exact=True).click()
    eventually(lambda: known(mapper) < before - 1)
    assert page.locator("dialog").count() == 0
    (cookie,) = page.context.cookies()
    assert (cookie["httpOnly"], cookie["sameSite"]) == (True, "Strict")
    assert TOKEN not in str(cookie)
    assert page.evaluate("() => JSON.stringify(localStorage)").find(TOKEN) == -1
    page.get_by_role("button", name="Log out").click()
    eventually(lambda: page.get_by_role("button", name="Log out").is_hidden())
    assert len(watched.complaints) == 2


def test_on_a_phone_the_panel_makes_room_for_the_area(changed, phone, keep, eventually):
    _, watched = changed(**phone)
    page = watched.page
    page.locator("#grip").tap()
    page.get_by_role("button", name="Erase an area").tap()
    asked = page.locator("#ask")
    assert asked.locator("p").inner_text() == "Tap the corners of the area to erase, then Done."
    below, sheet = asked.bounding_box(), page.locator("#panel").bounding_box()
    assert below["y"] + below["height"] <= sheet["y"]
    assert page.locator("#readout").is_hidden()
    for corner in AROUND_THE_HIT:
        page.touchscreen.tap(*watched.place(*corner))
    keep(watched, "erasing-phone")
    asked.get_by_role("button", name="Done").tap()
    asked.get_by_role("button", name="Erase", exact=True).tap()
    eventually(lambda: page.locator("#notice").inner_text() == "Erased 1 known cell.")
    assert watched.complaints == []


def test_an_area_is_drawn_by_keys_alone_and_given_up(changed, eventually):
    mapper, watched = changed()
    page = watched.page
    before = known(mapper)
    draw(watched, (1.5, -0.5))
    page.keyboard.press("Escape")
    assert page.locator("#ask").is_hidden()
    assert page.evaluate("() => ogm.state.tool") is None

    page.get_by_role("button", name="Erase an area").focus()
    page.keyboard.press("Enter")
    for corner in ((1.98, -0.5), (5.0, 5.0), (2.5, -0.5), (2.5, 0.5), (1.98, 0.5)):
        page.evaluate("([x, y]) => ogm.view.centreOn(x, y)", corner)
        page.keyboard.press("Space")
        if corner == (5.0, 5.0):
            page.keyboard.press("Backspace")
    page.keyboard.press("Enter")
    assert page.get_by_text("Make everything inside unknown?").is_visible()
    assert known(mapper) == before
    page.keyboard.press("Enter")
    eventually(lambda: known(mapper) == before - 1)
    assert watched.complaints == []


def test_an_area_outside_the_map_is_refused_in_words(changed, eventually):
    mapper, watched = changed()
    before = known(mapper)
    draw(watched, (-5.0, 2.0), (-4.0, 2.0), (-4.0, 3.0))
    watched.page.keyboard.press("Enter")
    watched.page.get_by_role("button", name="Erase", exact=True).click()
    said = watched.page.locator("#ask p")
    eventually(lambda: said.inner_text().startswith("Not erased: "))
    assert "outside" in said.inner_text()
    assert known(mapper) == before


def test_the_map_is_saved_and_emptied(changed, tmp_path, keep, eventually):
    mapper, watched = changed("--data", str(tmp_path / "data"))
    page = watched.page
    page.get_by_role("button", name="Save…").click()
    name = page.get_by_label("name", exact=True)
    name.fill("no name")
    page.keyboard.press("Enter")
    eventually(lambda: "a name of 1 to 64" in page.get_by_role("alert").inner_text())
    name.fill("before")
    page.keyboard.press("Enter")
    eventually(lambda: page.locator("#notice").inner_text() == "Saved as before, at revision 1.")
    (saved,) = mapper.get("snapshots").json()["snapshots"]
    assert (saved["name"], saved["revision"]) == ("before", 1)

    page.get_by_role("button", name="Empty it…").click()
    keep(watched, "emptying")
    page.keyboard.press("Escape")
    assert mapper.get("status").json()["revision"] == 1
    page.get_by_role("button", name="Empty it…").click()
    page.get_by_role("button", name="Empty it", exact=True).click()
    eventually(lambda: watched.state() == ("wait", "waiting for the first scan"))
    assert mapper.get("status").json()["revision"] == 0
    assert (
        page.locator("#notice").inner_text() == "Another map: it was emptied, or one that was saved is shown."
    )


def test_what_the_mapper_cannot_do_is_not_offered(changed, phone):
    _, watched = changed(**phone)
    watched.page.locator("#grip").tap()
    offered = watched.page.locator("#change button:visible").all_inner_texts()
    assert offered == ["Erase an area…", "Empty it…"]
