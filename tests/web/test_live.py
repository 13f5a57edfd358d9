"""The page follows the map: what is pushed is what is served; it comes back when the mapper does."""

import random
import re

import pytest

from page_desk import lap

HELD = """async () => {
  const found = [];
  for (const [key, {r, png}] of ogm.tiles.held) {
    const reply = await fetch(`tiles/${key}.png?palette=${ogm.state.palette}`, {cache: "no-store"});
    const served = new Uint8Array(await reply.arrayBuffer()), held = png && new Uint8Array(png);
    const alike = held ? held.length === served.length && held.every((byte, k) => byte === served[k])
      : reply.headers.get("OGM-Revision") === null;
    found.push([key, alike, r, Number(reply.headers.get("OGM-Revision"))]);
  }
  return found;
}"""
PUSHED = "() => [...ogm.tiles.held.values()].filter(({live, png, tag}) => live && png && tag === null).length"


def by(watched):
    """How the page learns of changes."""
    return watched.page.evaluate("() => ogm.state.connection.by")


def differing(watched):
    """Tiles that are held otherwise than they are served: key, whether bytes are alike, both revisions."""
    return [one for one in watched.page.evaluate(HELD) if not one[1] or one[2] != one[3]]


def assert_all_alike(watched, mapper, eventually):
    """The page has the mapper's revision, and each tile that it holds is byte for byte the one served."""
    revision = mapper.get("status").json()["revision"]
    eventually(lambda: watched.page.evaluate("() => ogm.state.map.revision") == revision)
    watched.page.evaluate(
        "() => ogm.tiles.want([...ogm.tiles.held.keys()].map((key) => key.split('/').map(Number)))"
    )
    watched.settle()
    # An update of the view before may have told of the revision a moment before that of this one.
    eventually(lambda: differing(watched) == [])
    assert len(watched.page.evaluate(HELD)) >= 4


@pytest.mark.parametrize("palette", ["ros", "cividis"])
def test_after_scans_and_a_walk_about_each_tile_is_as_the_mapper_has_it(mapper, look, eventually, palette):
    rng, scans = random.Random(3), lap()
    watched = look(mapper)
    with mapper.robot() as robot:
        mapper.drive(robot, scans[:5], eventually)
        watched.open()
        eventually(lambda: by(watched) == "push")
        watched.page.select_option("#palette", palette)
        for number in range(10):
            mapper.drive(robot, scans[5 + 5 * number : 10 + 5 * number], eventually)
            x, y, zoom = rng.uniform(-8, 8), rng.uniform(-8, 8), rng.choice([-2, -0.5, 0, 0.75, 2, 4])
            watched.page.evaluate("([x, y, zoom]) => ogm.view.centreOn(x, y, zoom)", [x, y, zoom])
        eventually(lambda: watched.page.evaluate("() => ogm.state.map.revision") == 55)
        watched.settle()
        mapper.drive(robot, scans[55:60], eventually)
        eventually(lambda: watched.page.evaluate(PUSHED) >= 1)
        watched.settle()
        assert by(watched) == "push"
        assert_all_alike(watched, mapper, eventually)
    assert watched.complaints == []


def test_a_mapper_that_is_killed_is_missed_and_found_again(mapper, look, keep, eventually):
    watched = look(mapper)
    with mapper.robot() as robot:
        mapper.drive(robot, lap()[:30], eventually)
        watched.open()
        old = watched.page.evaluate("() => ogm.state.map.epoch")
        mapper.kill()
        eventually(lambda: watched.state()[0] == "bad")
        # In no words of the browser's.
        assert re.fullmatch(r"no answer from the mapper( \(\w+: 503\))?", watched.state()[1])
        keep(watched, "gone")
        # However long that is, the map's name stays a line or two.
        assert watched.page.get_by_role("heading", level=1).bounding_box()["height"] < 60
    mapper.start()
    eventually(lambda: watched.state() == ("wait", "waiting for the first scan"))
    assert watched.page.evaluate("() => ogm.state.map.epoch") != old
    assert (
        watched.page.evaluate("() => [...ogm.tiles.held.values()].filter(({bitmap}) => bitmap).length") == 0
    )
    with mapper.robot() as robot:
        mapper.drive(robot, lap()[100:110], eventually)
        watched.settle()
        eventually(lambda: by(watched) == "push")
        assert_all_alike(watched, mapper, eventually)


def test_a_reset_empties_the_page(mapper, look, eventually):
    watched = look(mapper)
    with mapper.robot() as robot:
        mapper.drive(robot, lap()[:30], eventually)
        watched.open()
        eventually(lambda: watched.page.evaluate("() => ogm.canvas.layers.length") > 5)
        free = lap()[0].pose[:2]
        spot = free[0] + 0.5, free[1] + 0.5
        assert watched.colour(*spot) == "#fefefe"
        mapper.post("reset")
        eventually(lambda: watched.colour(*spot) == "transparent")
        eventually(lambda: watched.state()[0] == "wait")
        mapper.drive(robot, lap()[30:60], eventually)
        watched.settle()
        assert_all_alike(watched, mapper, eventually)
    assert watched.complaints == []


def test_without_a_web_socket_the_page_asks(mapper, look, eventually):
    watched = look(mapper)
    watched.page.route_web_socket("**/ws", lambda socket: socket.close())
    with mapper.robot() as robot:
        mapper.drive(robot, lap()[:5], eventually)
        watched.open()
        mapper.drive(robot, lap()[5:40], eventually)
        eventually(lambda: watched.page.evaluate("() => ogm.state.map.revision") == 40)
        watched.settle()
        assert by(watched) == "polling"
        assert_all_alike(watched, mapper, eventually)
        x, y, _ = lap()[39].pose
        assert watched.page.evaluate("() => ogm.state.robots.robot1.pose.slice(0, 2)") == pytest.approx(
            [x, y]
        )
    assert watched.complaints == []


def test_a_hidden_tab_asks_for_nothing_and_catches_up(mapper, look, eventually):
    watched = look(mapper)
    page = watched.page
    with mapper.robot() as robot:
        mapper.drive(robot, lap()[:5], eventually)
        watched.open()
        page.evaluate(HIDE, True)
        eventually(
            lambda: page.evaluate("() => ogm.link.live.push.socket === null && ogm.tiles.asking.size === 0")
        )
        asked = []
        page.on("request", lambda request: asked.append(request.url))
        mapper.drive(robot, lap()[5:40], eventually)
        page.evaluate("() => new Promise((done) => setTimeout(done, 1500))")
        assert asked == []
        page.evaluate(HIDE, False)
        eventually(lambda: page.evaluate("() => ogm.state.map.revision") == 40)
        watched.settle()
        assert_all_alike(watched, mapper, eventually)
    assert watched.complaints == []


HIDE = """(hidden) => {
  Object.defineProperty(document, "hidden", {value: hidden, configurable: true});
  document.dispatchEvent(new Event("visibilitychange"));
}"""
