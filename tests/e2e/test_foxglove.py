"""`ogm foxglove` as a command: what it prints, how it ends, and the layout that it writes."""

import json
import signal
import socket
import sys

from foxglove_viewer import viewing


def test_it_serves_a_viewer_until_ctrl_c(ogm):
    mapper = ogm.ready(ogm.mapper())
    bridge = ogm.start("foxglove", "--url", mapper.endpoint, "--port", 0)
    url = bridge.line(r"viewers  (ws://127\.0\.0\.1:\d+) ")[1]
    bridge.line(rf"map of   {mapper.endpoint}$")
    with viewing(url) as viewer:
        viewer.channel("/map")
        ended = bridge.stop(signal.SIGINT, group=True)
    assert (ended.code, ended.warnings) == (0, "")


def test_it_waits_for_a_mapper_and_ends_at_once_meanwhile(ogm, endpoint):
    bridge = ogm.start("foxglove", "--url", endpoint, "--port", 0)
    bridge.line(r"viewers  ws://")
    bridge.complains("waiting for a mapper or a Zenoh router at ")
    assert bridge.stop(signal.SIGINT).code == 0


def test_a_port_that_is_taken_is_said_in_a_line(ogm):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        complaint = ogm.call("foxglove", "--port", port).complaint(1)
    assert f"cannot listen on 127.0.0.1:{port}: Address already in use" in complaint


def test_who_lacks_the_extra_is_told_what_to_install(ogm, monkeypatch):
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert "pip install 'zenoh-ogm[foxglove]'" in ogm.call("foxglove").complaint(2)


def test_the_layout_shows_the_map_and_the_robots_and_their_scans(ogm, eventually):
    mapper = ogm.ready(ogm.mapper())
    ogm.start("simulate", "--connect", mapper.endpoint, "--robot-prefix", "lab", "--scans", 400)
    eventually(lambda: mapper.status()["scans"]["integrated"])
    ended = ogm.call("foxglove", "--url", mapper.url, "--layout", "ogm.json")
    assert ended.code == 0, ended
    assert ended.out.startswith("ogm.json: ")
    layout = json.loads((ogm.folder / "ogm.json").read_text())
    panel = layout["configById"][layout["layout"]]
    assert layout["layout"].startswith("3D!")
    assert {topic for topic, said in panel["topics"].items() if said["visible"]} == {
        *("/map", "/tf", "/robots"),
        "/robots/lab1/scan/laser",
    }
    assert panel["followTf"] == "map"
