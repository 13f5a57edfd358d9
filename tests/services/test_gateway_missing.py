"""A gateway as a service over fake shares: what it answers while some are missing, or of another map."""

import logging
import time
from contextlib import closing

import numpy as np

from cut_link import CutLink
from fleet_desk import Fleet, npz
from ogm_client.session import NetworkConfig, open_session
from ogm_core.files.map_files import encode_npz
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.map_update import encode_update
from ogm_services.mapper.shares import gathering
from ogm_services.mapper.shares.gathered_map import GatheredMap
from ogm_services.mapper.shares.gathering import Gathering
from shares_desk import FOUR, SETTINGS, FakeShare, ServedShare, scan_at


def test_while_a_share_is_missing_the_rest_is_told_and_says_so(fleet):
    fleet.integrate(8)
    _, http = fleet.gateway()
    whole = npz(http.get("/map.npz").content)
    fleet.shares[1].close()
    answer = http.get("/map.npz")
    assert answer.status_code == 200
    share, _, since = answer.headers["OGM-Missing"].partition(";since=")
    assert share == "1"
    assert abs(time.time_ns() - int(since)) < 60e9
    assert answer.headers["Cache-Control"] == "no-store"
    for coding in ("identity", "gzip"):
        text = http.get("/map.json", headers={"Accept-Encoding": coding})
        assert text.headers["Vary"] == "Accept-Encoding"
    assert not {"ETag", "OGM-Epoch", "OGM-Run", "OGM-Revision"} & {name.title() for name in answer.headers}
    assert not {"etag", "ogm-epoch", "ogm-run", "ogm-revision"} & set(answer.headers)
    part = npz(answer.content)
    x, y = part["offset"] - whole["offset"]
    height, width = part["log_odds"].shape
    expected = whole["log_odds"][y : y + height, x : x + width].copy()
    ix = np.arange(width) + part["offset"][0]
    iy = np.arange(height) + part["offset"][1]
    expected[(iy[:, None] < 0) & (ix[None, :] >= 0)] = np.nan
    assert np.array_equal(part["log_odds"], expected, equal_nan=True)
    shown = http.get("/map.json").json()
    assert shown["missing"] == [{"share": 1, "bounds": [0.0, None, None, 0.0], "since": int(since)}]
    assert "epoch" not in shown


def test_what_would_mislead_without_a_share_is_refused_until_it_is_there(fleet, eventually):
    fleet.integrate(8)
    _, http = fleet.gateway()
    fleet.shares[1].close()
    refused = (
        *("/map.yaml", "/map.pgm", "/map.png?complete=1", "/distance.png", "/inflate.png?radius=0.2"),
        *("/raycast?x=-1&y=-1&range_max=2", "/cell?x=1&y=-1", "/inflate.png?radius=1&region=-2,-2,-0.5,0"),
        *("/map.pgm?region=-1,-1,0.05,0", "/map.json?complete=1&region=-1,-1,0.05,0"),
    )
    for asked in refused:
        answer = http.get(asked)
        assert (answer.status_code, answer.json()["type"]) == (503, "partial-map"), asked
        assert "share 1" in answer.json()["detail"]
        assert int(answer.headers["Retry-After"]) > 0
    assert http.get("/map.png?at=lunch").status_code == 501
    assert http.get("/map.pgm?complete=0").headers["OGM-Missing"].startswith("1;")
    assert http.get("/cell?x=-1&y=1").json()["known"] in (True, False)
    assert http.get("/readyz").status_code == 200
    fleet.shares[1] = ServedShare(fleet.join(), fleet.shares[1].share)
    eventually(lambda: "OGM-Missing" not in http.get("/map.png").headers)
    for asked in refused:
        assert http.get(asked).status_code == 200, asked
    assert "OGM-Missing" not in http.get("/map.png").headers


def test_who_begins_to_follow_is_refused_while_a_gateway_has_never_heard_of_a_share(fleet, eventually):
    """What is held goes on; of a share of which nothing is held a copy would lack all, and not say so."""
    fleet.integrate(8)
    _, heard = fleet.gateway()
    before = heard.get("/map.tiles").content
    share = fleet.shares[1].share
    fleet.shares[1].close()
    _, http = fleet.gateway()
    answer = http.get("/map.tiles")
    assert (answer.status_code, answer.json()["type"]) == (503, "partial-map")
    assert answer.json()["detail"].startswith("share 1 of the map does not answer")
    assert heard.get("/map.tiles").content == before
    fleet.shares[1] = ServedShare(fleet.join(), share)
    eventually(lambda: http.get("/map.tiles").status_code == 200)


def shares_up(http):
    """What /metrics say of each share of a gateway."""
    lines = http.get("/metrics").text.splitlines()
    return [float(line.split()[-1]) for line in lines if line.startswith("ogm_share_up{")]


def test_no_share_at_all_is_not_ready(endpoint):
    fleet = Fleet(endpoint, shares=())
    try:
        _, http = fleet.gateway()
        assert http.get("/readyz").status_code == 503
        assert "no share" in http.get("/readyz").text
        answer = http.get("/map.json")
        assert [each["share"] for each in answer.json()["missing"]] == [0, 1, 2, 3]
        assert http.get("/status").json()["complete"] is False
    finally:
        fleet.close()


def test_a_share_that_keeps_silent_holds_nobody_up_for_longer_than_the_timeout(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway(timeout=0.3)
    fleet.shares[2].silent = True
    answer = http.get("/map.npz")
    assert answer.headers["OGM-Missing"].startswith("2;")
    fleet.shares[2].silent = False
    assert "OGM-Missing" not in http.get("/map.npz").headers


def test_the_log_tells_of_a_share_that_is_silent_twice_in_a_row(fleet, caplog, monkeypatch):
    late, asked = [], gathering.ask_shares

    def answered(*given):
        for share, answers in asked(*given):
            yield share, [] if share in late else answers

    monkeypatch.setattr(gathering, "ask_shares", answered)
    gathers = Gathering(fleet.join(), MapKeys("m"), GatheredMap(SETTINGS, FOUR, "run"), 30.0)

    def missing(*shares):
        late[:] = shares
        return [each.share for each in gathers.gather().missing]

    with caplog.at_level(logging.INFO, gathering.__name__):
        assert missing() == []
        caplog.clear()
        assert (missing(2), missing(), missing(2), missing()) == ([2], [], [2], [])
        assert caplog.messages == []
        assert (missing(2), missing(2), missing(2), missing()) == ([2], [2], [2], [])
    assert caplog.messages == ["share 2 does not answer: its part of the map is missing", "share 2 answers"]


def test_a_share_whose_link_breaks_in_the_middle_of_its_reply_is_missing_as_a_whole(fleet):
    fleet.integrate(30)
    share = fleet.shares[1].share
    fleet.shares[1].close()
    few = 4_000
    assert sum(map(len, map(encode_update, share.updates()))) > 2 * few
    link = CutLink(fleet.endpoint, few)
    with closing(link), open_session(NetworkConfig(connect=(link.endpoint,))) as session:
        fleet.shares[1] = ServedShare(session, share)
        link.armed.set()
        _, http = fleet.gateway()
        part = http.get("/map.npz")
        assert link.cut.is_set()
        link.close()  # a session that waits for an answer there takes long to close
    assert fleet.shares[1].asked == [None], "it was asked for all of its cells"
    assert part.headers["OGM-Missing"].startswith("1;")
    arrays = npz(part.content)
    iy, ix = np.nonzero(~np.isnan(arrays["log_odds"])) + np.array(arrays["offset"][::-1])[:, None]
    assert not ((ix >= 0) & (iy < 0)).any(), "nothing of it is shown"
    fleet.shares[1] = ServedShare(fleet.join(), share)
    assert http.get("/map.npz").content == encode_npz(fleet.one.snapshot())


def test_a_reset_of_which_a_share_has_not_heard_is_not_done(fleet):
    fleet.integrate(4)
    _, http = fleet.gateway()
    share = fleet.shares[2].share
    fleet.shares[2].close()
    answer = http.post("/reset")
    assert (answer.status_code, answer.json()["type"]) == (503, "partial-map")
    assert "share 2 " in answer.json()["detail"]
    fleet.shares[2] = ServedShare(fleet.join(), share)
    assert http.get("/map.json").json()["width"] > 0  # it keeps its cells
    assert http.post("/reset").status_code == 200
    assert http.get("/map.json").json()["width"] == 0


def test_a_share_of_other_settings_is_missing_and_the_gateway_says_why(fleet, caplog):
    fleet.integrate(2)
    _, http = fleet.gateway(cuts_x=[3.2])
    assert "OGM-Missing" in http.get("/map.npz").headers
    why = http.get("/readyz").text
    assert "cuts_x" in why
    assert "[3.2]" in why
    assert any("cuts_x" in record.getMessage() for record in caplog.records)
    assert "cuts_x" in http.get("/status").json()["shares"][0]["detail"]
    assert shares_up(http) == [0.0, 0.0, 0.0, 0.0], "they answer, and are not taken"
    fleet.shares[0].close()
    silent, refused, *_ = http.get("/status").json()["shares"]
    assert (silent["state"], silent["detail"], refused["state"]) == ("missing", None, "missing")
    assert "cuts_x" in refused["detail"]
    _, fitting = fleet.gateway()
    fleet.shares[3].close()
    assert fitting.get("/map.npz").headers["OGM-Missing"].startswith("0;")
    assert shares_up(fitting) == [0.0, 1.0, 1.0, 0.0]


def test_of_two_processes_of_a_share_the_one_that_was_heard_of_last_counts(fleet, eventually):
    fleet.integrate(3)
    _, http = fleet.gateway()
    old = http.get("/map.json").json()
    newer = FakeShare(2, epoch="e2", run="newer")
    served = ServedShare(fleet.join(), newer)
    placed = scan_at(50, fleet.rng)
    newer.integrate(*placed)

    def taken():
        return http.get("/status").json()["shares"][2]["run"]

    eventually(lambda: taken() == "newer")
    assert [taken() for _ in range(3)] == ["newer"] * 3
    served.close()
    eventually(lambda: http.get("/map.json").json()["run"] == old["run"])  # the old one is all there is
