"""A gateway as a service over fake shares: what it answers while all of them are there."""

import pytest

from ogm_core.files.map_files import encode_npz
from ogm_core.status import StoreInfo
from ogm_core.types import Pose
from shares_desk import scan_at


def test_a_gateway_answers_as_one_mapper_would(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    whole = fleet.one.snapshot()
    answer = http.get("/map.npz")
    assert answer.content == encode_npz(whole)
    assert answer.headers["OGM-Revision"] == "32"
    assert answer.headers["ETag"].startswith(f'"{answer.headers["OGM-Epoch"]}-{answer.headers["OGM-Run"]}-')
    assert http.get("/map.npz", headers={"If-None-Match": answer.headers["ETag"]}).status_code == 304
    shown = http.get("/map.json").json()
    assert (shown["width"], shown["height"], shown["offset"]) == (
        whole.width,
        whole.height,
        list(whole.offset),
    )
    assert "missing" not in shown
    fleet.integrate(1)
    later = http.get("/map.npz", headers={"If-None-Match": answer.headers["ETag"]})
    assert later.content == encode_npz(fleet.one.snapshot())
    assert later.headers["OGM-Revision"] == "36"
    for name in (
        "map.png",
        "map.pgm",
        "map.yaml",
        "distance.png",
        "quality",
        "tiles.json",
        "metrics",
        "map.tiles",
    ):
        assert http.get(f"/{name}").status_code == 200, name
    assert http.get("/readyz").text == "ok"


def test_two_gateways_give_equal_tags_to_equal_bytes(fleet):
    fleet.integrate(5)
    (_, first), (_, second) = fleet.gateway(), fleet.gateway()
    fleet.integrate(1)
    for name in ("map.png", "map.npz", "map.json", "map.pgm?palette=probability"):
        one, other = first.get(f"/{name}"), second.get(f"/{name}")
        assert one.headers["ETag"] == other.headers["ETag"]
        assert one.content == other.content


def test_two_gateways_give_tiles_equal_tags_and_a_new_one_when_their_share_has_changed(fleet):
    (_, first), (_, second) = fleet.gateway(), fleet.gateway()
    fleet.integrate(5)

    def tiles(http):
        return {(x, y): http.get(f"/tiles/16/{x}/{y}.png") for x in (-1, 0) for y in (-1, 0)}

    one, other = tiles(first), tiles(second)
    for place, tile in one.items():
        assert tile.headers["ETag"] == other[place].headers["ETag"]
        assert tile.headers["ETag"].startswith(f'"{tile.headers["OGM-Epoch"]}-')
        assert tile.content == other[place].content
    assert len({tile.headers["ETag"] for tile in one.values()}) == 4
    placed = scan_at(99, fleet.rng)
    fleet.shares[3].share.integrate(placed[0], Pose(7.0, 7.0, 0.0))  # in the north-east
    changed = tiles(first)
    same = {place for place, tile in changed.items() if tile.headers["ETag"] == one[place].headers["ETag"]}
    assert same == {(-1, -1), (-1, 0), (0, 0)}
    asked = {"If-None-Match": one[0, 0].headers["ETag"]}
    assert first.get("/tiles/16/0/0.png", headers=asked).status_code == 304
    tag = changed[0, -1].headers["ETag"].strip('"')
    assert "immutable" in first.get(f"/tiles/16/0/-1.png?rev={tag}").headers["Cache-Control"]


def test_only_what_has_changed_is_asked_for(fleet):
    fleet.integrate(3)
    _, http = fleet.gateway()
    http.get("/map.npz")
    part = fleet.shares[0].share.state
    http.get("/map.npz")
    assert fleet.shares[0].asked[-1] == f"{part.epoch}-{part.run}-{part.revision}"


def test_the_status_adds_up_what_the_shares_have_counted(fleet):
    fleet.integrate(6)
    _, http = fleet.gateway()
    for k, served in enumerate(fleet.shares):
        dropped = {"limit": k, "no_pose": 2}
        served.scans = {"received": 40, "integrated": 5 + k, "pending": 6, "dropped": dropped, "lost": 3}
    status = http.get("/status").json()
    scans = status["scans"]
    assert (scans["received"], scans["integrated"], scans["lost"]) == (40, 26, 3)
    assert (scans["dropped"]["limit"], scans["dropped"]["no_pose"]) == (6, 2)
    assert scans["pending"] == 6
    assert status["map_info"]["known_cells"] == fleet.one.snapshot().known_cells
    assert status["complete"] is True
    assert [(s["share"], s["state"], s["revision"]) for s in status["shares"]] == [
        (k, "up", 6) for k in range(4)
    ]
    assert status["shares"][1]["bounds"] == [0.0, None, None, 0.0]
    fleet.shares[3].scans["integrated"] = 0  # it has begun to count anew
    assert http.get("/status").json()["complete"] is False
    fleet.shares[3].scans |= {"integrated": 11, "dropped": {"overload": 1}}
    fleet.shares[2].store = StoreInfo(3, "disk full", 10)
    fleet.shares[1].restored, fleet.shares[2].restored = False, True
    status = http.get("/status").json()
    assert status["complete"] is False
    assert status["shares"][3]["overload"] == 1
    assert (status["shares"][2]["state"], status["shares"][2]["detail"]) == ("not storing", "disk full")
    assert [share["restored"] for share in status["shares"]] == [None, False, True, None]
    assert status["restored"] is None, "a gateway has no store"
    fleet.shares[0].close()
    status = http.get("/status").json()
    assert (status["shares"][0]["state"], status["complete"]) == ("missing", False)


def test_reset_is_done_when_every_share_has_begun_a_new_epoch(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway()
    before = http.get("/status").json()["epoch"]
    answer = http.post("/reset")
    assert answer.status_code == 200
    assert answer.json()["epoch"] != before
    assert answer.json()["revision"] == 0
    assert http.get("/map.json").json()["width"] == 0


def test_what_a_gateway_cannot_do_it_says(fleet):
    _, http = fleet.gateway()
    for asked in ("POST /erase?region=0,0,1,1", "POST /save?name=x", "DELETE /snapshots/x"):
        answer = http.request(*asked.split())
        assert (answer.status_code, answer.json()["type"]) == (501, "not-by-gateway"), asked
    for asked in ("/snapshots", "/map.png?at=x"):
        answer = http.get(asked)
        assert (answer.status_code, answer.json()["type"]) == (501, "not-by-gateway"), asked
    assert http.get("/login").json()["writes"] == ["reset"], "its page offers nothing else"


def test_the_figures_of_a_gateway_are_those_of_the_whole_map(fleet):
    fleet.integrate(6)
    _, http = fleet.gateway()
    for served in fleet.shares:
        served.scans |= {"received": 6, "integrated": 2}
    quality, whole = http.get("/quality").json(), fleet.one.snapshot()
    assert quality["known_m2"] == pytest.approx(whole.known_cells * 0.05**2)
    assert (quality["scans"], quality["cell_updates"]) == (8, None)
    assert "missing_shares" not in quality
    fleet.shares[1].close()
    assert [each["share"] for each in http.get("/quality").json()["missing_shares"]] == [1]
