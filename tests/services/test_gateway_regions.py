"""A gateway that is asked about a part of its map: it asks the shares that this meets, no others."""

import math
import threading
from contextlib import closing

import numpy as np
import pytest
from numpy.testing import assert_equal

from fleet_desk import Fleet, npz
from ogm_client import MapClient
from ogm_core.files.map_files import encode_npz
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.shares import Cuts
from ogm_services.mapper.shares.layout import ShareLayout
from ogm_services.replies.answer import PartOfMap

WEST = "-3,-3,0,3"
"""Shares 0 and 2 own it: it ends where 1 and 3 begin."""


def test_a_region_is_whole_while_a_share_elsewhere_is_missing(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    served = http.get(f"/map.npz?region={WEST}")
    fleet.shares[1].close()
    fleet.integrate(1)
    answer = http.get(f"/map.npz?region={WEST}")
    assert answer.content == encode_npz(fleet.one.snapshot().crop(Region(-3.0, -3.0, 0.0, 3.0)))
    assert "OGM-Missing" not in answer.headers
    assert answer.headers["ETag"] != served.headers["ETag"]
    again = http.get(f"/map.npz?region={WEST}", headers={"If-None-Match": answer.headers["ETag"]})
    assert again.status_code == 304
    shown = http.get(f"/map.json?complete=1&region={WEST}")
    assert shown.status_code == 200
    assert "missing" not in shown.json()
    assert shown.json()["epoch"] == answer.headers["OGM-Epoch"]
    assert http.get("/map.json").json()["missing"][0]["share"] == 1


def test_of_missing_shares_those_are_named_that_a_region_meets(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    fleet.shares[1].close()
    fleet.shares[2].close()
    assert http.get("/map.png?region=-3,-3,0.1,-1").headers["OGM-Missing"].startswith("1;")
    missing = http.get("/map.json?region=-3,-3,0.1,-1").json()["missing"]
    assert [each["share"] for each in missing] == [1]
    assert http.get("/map.png").headers["OGM-Missing-Bounds"].count(";") == 1
    # As of one mapper, where a share is missing that the region does not meet.
    assert http.get("/map.pgm?region=-3,-3,0,0").status_code == 200
    assert http.get("/map.json?region=1,1,1,2").status_code == 400
    fleet.shares[3].close()
    _, later = fleet.gateway()
    # All that this one has heard of ends at 0: nobody knows that this lies outside the map.
    assert later.get("/map.json?region=1,-3,2,-1").json()["type"] == "partial-map"
    assert later.get("/map.json?region=-2,-3,-1,-1").status_code == 200


def test_questions_about_a_place_are_answered_while_a_share_elsewhere_is_missing(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    asked = (
        *("/cell?x=-0.01&y=-1", "/raycast?x=-1&y=-1&range_max=3&angle_min=3.141592653589793"),
        *("/distance.npz?max_distance=1&region=-3,-3,-1.2,3", "/inflate.npz?radius=0.5&region=-3,-3,-1,3"),
    )
    points = {"points": [[-1.0, -1.0], [-2.0, 2.0]], "margin": 0.2}
    whole = [http.get(each).content for each in asked]
    states = http.post("/check", json=points).json()["states"]
    fleet.shares[1].close()
    assert [http.get(each).content for each in asked] == whole
    assert http.post("/check", json=points).json()["states"] == states
    for refused in ("/cell?x=0&y=-1", "/raycast?x=-1&y=-1&range_max=3", "/distance.npz?region=-3,-3,-1,3"):
        assert http.get(refused).status_code == 503, refused
    points["points"].append([-0.1, -1.0])
    assert http.post("/check", json=points).status_code == 503


def test_the_client_library_gets_a_region_while_a_share_elsewhere_is_missing(fleet):
    fleet.integrate(8)
    fleet.gateway()
    fleet.shares[1].close()
    with MapClient(map_name="m", session=fleet.join(), timeout=30.0) as client:
        part = client.get_map(region=(-3.0, -3.0, 0.0, 3.0))
    assert part.missing == ()
    expected = npz(encode_npz(fleet.one.snapshot().crop(Region(-3.0, -3.0, 0.0, 3.0))))
    assert np.array_equal(part.log_odds, expected["log_odds"], equal_nan=True)


def test_a_share_that_keeps_silent_elsewhere_holds_up_nobody_who_asks_about_a_region(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway(timeout=10.0)
    fleet.shares[1].silent = True
    found = []
    waiting = threading.Thread(target=lambda: found.append(http.get("/map.png")))
    waiting.start()
    try:
        fleet.integrate(1)
        answer = http.get(f"/map.npz?region={WEST}")
        assert answer.content == encode_npz(fleet.one.snapshot().crop(Region(-3.0, -3.0, 0.0, 3.0)))
        assert not found, "the whole map is still waited for"
    finally:
        fleet.shares[1].close()
        waiting.join()
    assert found[0].headers["OGM-Missing"].startswith("1;")


@pytest.mark.parametrize(("model", "status"), [("log_odds", 200), ("rate", 503)])
def test_where_cells_depend_on_those_around_their_shares_are_needed_too(endpoint, model, status):
    with closing(Fleet(endpoint, cell_model=model)) as fleet:
        fleet.integrate(4)
        _, http = fleet.gateway()
        fleet.shares[1].close()
        # A half looks at three halves on every side: the first of cell -2 at the second of cell 0.
        for asked in ("/cell?x=-0.01&y=-1", "/cell?x=-0.06&y=-1", f"/map.pgm?region={WEST}"):
            assert http.get(asked).status_code == status
        assert http.get("/cell?x=-0.11&y=-1").status_code == 200


def test_a_map_larger_than_a_gateways_memory_is_looked_at_by_region(fleet):
    (service, http), (_, ample) = fleet.gateway(), fleet.gateway()
    gathered = service.parts.gathered
    gathered._max_bytes = 200_000
    fleet.integrate(8)
    missing = [each["share"] for each in http.get("/map.json").json()["missing"]]
    assert 0 < len(missing) < 4
    assert "max_memory" in http.get("/status").json()["shares"][missing[0]]["detail"]
    assert "not fit into mapper.max_memory" in http.get("/map.tiles").json()["detail"]
    (asked := fleet.shares[missing[0]].asked).clear()
    fleet.integrate(1)
    for gateway in (http, ample):
        gateway.get("/map.json")
    assert "1e300,1e300,2e300,2e300" in asked
    assert None not in asked, "its cells are not asked for again and again"
    gathered._max_bytes = gathered.state.copies.nbytes + 50_000
    for x, y in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        for question in (
            f"/map.npz?region={x - 1},{y - 1},{x + 1},{y + 1}",
            *(f"/map.pgm?region={x - 1},{y - 1},{x + 1},{y + 1}", f"/cell?x={x}&y={y}"),
            *(f"/raycast?x={x}&y={y}&n=9&angle_increment=0.7&range_max=0.9",),
            f"/inflate.npz?radius=0.2&region={x - 0.5},{y - 0.5},{x + 0.5},{y + 0.5}",
        ):
            answer, whole = http.get(question), ample.get(question)
            assert answer.content == whole.content, question
            assert answer.headers.get("ETag") == whole.headers.get("ETag")
        points = {"points": [[x, y]], "margin": 0.2}
        assert http.post("/check", json=points).content == ample.post("/check", json=points).content
    assert http.get("/map.png?region=-6,-6,6,6").json()["type"] == "busy"


def test_what_is_asked_of_a_share_that_is_not_held_is_as_new_as_the_question(fleet):
    (service, http), (_, ample) = fleet.gateway(), fleet.gateway()
    gathered = service.parts.gathered
    gathered._max_bytes = 200_000
    fleet.integrate(8)
    missing = [each["share"] for each in http.get("/map.json").json()["missing"]]
    service.parts.keeping_up.stop()  # which hears now and then of what is not held
    gathered._max_bytes += 200_000  # for what is asked for in passing
    x0, y0 = (-2.5 if missing[0] in (0, 2) else 0.5), (-2.5 if missing[0] in (0, 1) else 0.5)
    questions = {
        name: f"/{layer}&region={x0},{y0},{x0 + 2},{y0 + 2}"
        for name, layer in (
            ("distance", "distance.npz?max_distance=0.5"),
            ("occupancy", "inflate.npz?radius=0.3"),
        )
    }
    for _ in range(3):
        for name, question in questions.items():
            assert_equal(npz(http.get(question).content)[name], npz(ample.get(question).content)[name])
        fleet.integrate(1)


def test_a_map_that_was_waited_for_lacks_no_share_that_has_become_too_large_meanwhile(fleet, monkeypatch):
    service, http = fleet.gateway()
    gathered, answers = service.parts.gathered, service.parts.answers
    fleet.integrate(8)
    http.get("/map.json")
    service.parts.keeping_up.stop()
    gather, left = service.parts.gathering.gather, [1]

    def gathered_twice(*shares):
        """Another thread gathers once more right after this one, and there is no room."""
        found = gather(*shares)
        if left:
            left.clear()
            fleet.integrate(1)
            gathered._max_bytes = 200_000
            gather()
        return found

    monkeypatch.setattr(service.parts.gathering, "gather", gathered_twice)
    answer = answers.map("npz", {})
    assert gathered.state.not_held
    assert answer.meta.get("missing"), "cells that are not held are told as unknown"
    with pytest.raises(PartOfMap, match="does not fit"):
        answers.map("npz", {"complete": "1"})
    gathered._max_bytes = math.inf


def test_a_gateway_that_holds_no_share_is_ready_while_they_answer_and_says_which_are_silent(fleet, caplog):
    service, http = fleet.gateway()
    service.parts.gathered._max_bytes = 1000
    fleet.integrate(8)
    for _ in range(3):
        assert len(http.get("/map.json").json()["missing"]) == 4
        assert "share 0, 1, 2, 3 of the map does not fit" in http.get("/map.pgm").json()["detail"]
    assert http.get("/readyz").text == "ok"
    assert "does not answer" not in caplog.text
    for share in fleet.shares:
        share.close()
    for asked in ("/cell?x=-1&y=-1", "/map.pgm"):
        assert "does not answer" in http.get(asked).json()["detail"]
    assert http.get("/readyz").status_code == 503
    assert caplog.text.count("does not answer") == 4


def test_of_a_map_that_begins_anew_a_gateway_holds_again_what_was_too_large(fleet):
    service, http = fleet.gateway()
    service.parts.gathered._max_bytes = 200_000
    fleet.integrate(8)
    assert "OGM-Missing" in http.get("/map.npz").headers
    for served in fleet.shares:
        served.share.grid.reset("another")
    fleet.one.reset("another")
    fleet.integrate(1)
    http.get("/map.npz")
    assert http.get("/map.npz").content == encode_npz(fleet.one.snapshot())


def test_a_rectangle_meets_the_shares_that_own_its_cells():
    layout = ShareLayout.of(Cuts((-6.4, 0.0, 3.2), (3.2,)), Lattice(0.05))
    rng = np.random.default_rng(4)
    for _ in range(300):
        rect = CellRect(*rng.integers(-200, 150, 2).tolist(), *rng.integers(1, 200, 2).tolist())
        ix, iy = (np.arange(low, low + size) // 64 for low, size in (rect[::2], rect[1::2]))
        tiles = np.stack(np.meshgrid(np.unique(ix), np.unique(iy)), axis=-1).reshape(-1, 2)
        assert layout.met(rect) == set(layout.owners(tiles).tolist())
