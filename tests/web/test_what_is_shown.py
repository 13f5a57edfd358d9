"""What the canvas and the readout say of a place is what the map holds there."""

import json
import math
import re

import pytest

from page_desk import lap, module

PALETTES = "ros", "probability", "cividis", "dark", "costmap"


def cell(mapper, x, y):
    """What the mapper says of a cell."""
    return mapper.get(f"cell?x={x}&y={y}").json()


@pytest.fixture(scope="module")
def places(lab):
    """Middles of cells of the lab that are certain, far from robots: on a wall, free, and outside."""
    found = {}
    for number in range(-90, 90):
        y = 0.05 + 0.1 * number
        for x in (-10.05, -9.95):
            told = cell(lab, x, y)
            if told["known"] and told["probability"] > 0.9 and "occupied" not in found:
                found["occupied"] = x, y
    found["free"], found["unknown"] = (-6.95, 7.05), (-12.05, 0.05)
    assert cell(lab, *found["free"])["probability"] < 0.1
    assert not cell(lab, *found["unknown"])["known"]
    return found


@pytest.mark.parametrize("zoom", [0, 2])
def test_a_cell_has_its_colour_and_the_readout_says_what_it_is(lab, look, places, eventually, zoom):
    watched = look(lab)
    watched.open()
    for meaning, (x, y) in places.items():
        # A pixel off the middle, where no cross is.
        watched.show(x + 1.0, y + 1.0, zoom)
        expected = {"occupied": "#000000", "free": "#fefefe", "unknown": "transparent"}[meaning]
        assert watched.colour(x, y) == expected
        watched.page.mouse.move(*watched.place(x, y))
        told = cell(lab, x, y)
        said = f"p {told['probability']:.3f} {meaning}" if told["known"] else meaning
        wanted = [f"cell {told['ix']}, {told['iy']}", said]
        eventually(lambda wanted=wanted: watched.page.locator("#place div").all_text_contents()[1:] == wanted)
        shown = watched.page.locator("#place div").first.text_content()
        u, v = map(float, shown.removesuffix(" m").split(","))
        assert abs(u - x) <= 0.055
        assert abs(v - y) <= 0.055
    assert watched.complaints == []


def test_each_palette_shows_what_its_legend_says(lab, look, places):
    watched = look(lab)
    watched.open()
    legend = json.loads(lab.get("tiles.json").text)["ogm"]["legend"]
    assert watched.page.locator("#palette option").all_text_contents() == list(PALETTES)
    for palette in PALETTES[::-1]:
        watched.page.select_option("#palette", palette)
        watched.settle()
        x, y = places["free"]
        shown = watched.colour(x, y)
        wanted = legend[palette]["free"]
        # Nearly certain is nearly that colour.
        assert max(abs(int(shown[k : k + 2], 16) - int(wanted[k : k + 2], 16)) for k in (1, 3, 5)) <= 4
        ground = watched.page.evaluate(
            "() => getComputedStyle(document.getElementById('map')).backgroundColor"
        )
        red, green, blue = (int(legend[palette]["unknown"][k : k + 2], 16) for k in (1, 3, 5))
        assert ground == f"rgb({red}, {green}, {blue})"
    assert watched.complaints == []


def test_thin_walls_are_seen_at_any_zoom(lab, look):
    watched = look(lab)
    watched.open()
    for zoom in (-1, -2, -3, -3.75):
        watched.show(0.0, 0.0, zoom)
        # Along the left wall, where the robot has seen nearly all of it.
        dark = 0
        for number in range(-80, 80, 2):
            column = [watched.colour(-10.0 + off * 0.1 * 2**-zoom, number / 10) for off in (-1, 0, 1)]
            dark += any(shown != "transparent" and int(shown[1:3], 16) < 0xC0 for shown in column)
        assert dark >= 70, zoom


def test_a_robot_is_an_arrow_that_moves(mapper, look, eventually):
    watched = look(mapper)
    with mapper.robot() as robot:
        first, second = lap()[0], lap()[60]
        mapper.drive(robot, [first], eventually)
        watched.open()
        for placed in (first, second):
            if placed is second:
                mapper.drive(robot, [second], eventually)
            x, y, theta = placed.pose
            eventually(lambda x=x: watched.page.evaluate(ROBOT_X) == pytest.approx(x))
            watched.show(x, y, 2)
            metre = watched.page.evaluate("() => ogm.view.now().metre")
            along = 5 / metre
            ahead = watched.colour(x + along * math.cos(theta), y + along * math.sin(theta))
            beside = watched.colour(x - 2 * along * math.sin(theta), y + 2 * along * math.cos(theta))
            assert ahead == watched.page.evaluate(INK)
            assert beside != ahead
    assert watched.complaints == []


ROBOT_X = "() => ogm.state.robots.robot1?.pose?.[0]"


def test_walls_are_fitted_without_the_few_cells_that_lie_astray(lab, look):
    watched = look(lab)
    watched.page.goto(lab.url)
    spans = watched.page.evaluate(
        f"async (rows) => {{ const {{span}} = await {module('walls')}; return rows.map(span); }}",
        [
            [0, 3, *[1] * 8, 3, 0],
            [0] * 50 + [7],
            [1, *[0] * 99, *[20] * 20, *[0] * 99, 1],
            [1, 0, 100, 100, 0, 1],
        ],
    )
    assert spans == [[1, 11], [50, 51], [99, 121], [1, 5]]


INK = """async () => {
  const pen = document.createElement("canvas").getContext("2d");
  pen.fillStyle = "hsl(20 85% 40%)";
  return pen.fillStyle;
}"""


NAMES = """async () => {
  const {namesLayer} = await MODULE, said = [], robot = (x, y) => ({pose: [x, y, 0], alive: true});
  const pen = {
    measureText: (text) => ({width: 7 * text.length}), strokeText() {}, fillText: (text) => said.push(text),
  };
  const before = ogm.state.robots, view = {width: 900, toCanvas: (x, y) => [60 * x, 60 * y]};
  ogm.state.robots = {a: robot(0, 0), b: robot(0.1, 0), c: robot(5, 0), d: robot(0, 1)};
  for (ogm.state.followed of [null, "b"]) namesLayer.draw(pen, view);
  Object.assign(ogm.state, {robots: before, followed: null});
  return said;
}"""


def test_of_names_that_would_lie_over_each_other_one_is_drawn(lab, look):
    watched = look(lab)
    watched.open()
    drawn = watched.page.evaluate(NAMES.replace("MODULE", module("overlay")))
    assert drawn == ["a", "c", "d", "b", "c", "d"]


def test_what_is_small_keeps_two_digits(lab, look):
    watched = look(lab)
    watched.open()
    said = watched.page.evaluate(
        f"async () => {{ const {{area, metresBy}} = await {module('units')};"
        " return [area(0), area(0.0025), area(0.96), area(12.34), metresBy(0.05, 20)]; }"
    )
    assert said == ["0.0 m²", "0.0025 m²", "0.96 m²", "12.3 m²", "0.05 × 20.0 m"]


def test_a_part_that_goes_and_comes_changes_no_rate_of_scans(lab, look, eventually):
    """A gateway's counts lack those of a share that is missing."""
    watched = look(lab)
    status = lab.get("status").json()
    missing = [{"share": 3, "bounds": [None, None, 0.0, None], "since": None}]
    told = {**status, "scans": {**status["scans"], "integrated": 5000}, "missing": []}
    watched.page.route("**/status", lambda route: route.fulfill(json=told))
    watched.open()
    now = watched.page.locator("#now")
    eventually(lambda: "0.0 scans/s" in now.inner_text())
    for integrated, parts in ((3000, missing), (5000, [])):
        told |= {"scans": {**status["scans"], "integrated": integrated}, "missing": parts}
        rates = []

        def steady(rates=rates, parts=parts):
            rates.extend(re.findall(r"(-?[\d.]+) scans/s", now.inner_text()))
            return len(rates) > 10 and watched.page.locator("#parts").is_visible() == bool(parts)

        eventually(steady)
        assert set(rates) == {"0.0"}
