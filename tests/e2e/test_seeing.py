"""What an operator sees of a mapper: its log from start to end, and its status while it comes and goes."""

import json
import re
import signal
import socket
import urllib.request
from importlib.metadata import version

import pytest

from ogm_client import RobotPublisher

SWEEP = {"angle_min": 0.0, "angle_increment": 0.5, "range_min": 0.0, "range_max": 9.0}


def live(ogm, eventually, *flags):
    """How a mapper ends that a robot came to, mapped with, and left, and that somebody has reset."""
    mapper = ogm.ready(ogm.mapper(*flags))
    with RobotPublisher("r1", address=mapper.endpoint) as robot:
        robot.wait_for_mapper(30.0)
        robot.publish_scan([1.0, 2.0], **SWEEP, stamp=10**18, pose=(0.0, 0.0, 0.0))
        mapper.command.complains("robot r1 came")
        eventually(lambda: mapper.status()["revision"] == 1)
    mapper.command.complains("robot r1 went")
    urllib.request.urlopen(urllib.request.Request(f"{mapper.url}reset", method="POST"), timeout=30).close()
    return mapper.command.stop()


LIFE = [
    rf"zenoh-ogm {re.escape(version('zenoh-ogm'))} starts, with map\.resolution=0\.1, "
    r"network\.listen=tcp/\S+, http\.port=0, log\.format=json",
    "robot r1 came",
    "robot r1 went: it does not say any more that it is alive",
    "127.0.0.1 over HTTP has reset the map: epoch [0-9a-f]{32}",
    r"the mapper has stopped: 1 scans received, 1 integrated, 0 pending, dropped: none; it was up for \d+ s",
]


def test_a_life_in_json_is_a_line_an_event(ogm, eventually):
    ended = live(ogm, eventually, "--log-format", "json", "--resolution", "0.1")
    lines = [json.loads(line) for line in ended.err.splitlines()]
    for line, wanted in zip(lines, LIFE, strict=True):
        assert re.fullmatch(wanted, line.pop("message"))
        assert line.pop("time").endswith("Z")
        assert line.pop("logger").startswith("ogm_services.mapper.")
        assert line == {"level": "info"}
    assert ended.code == 0
    assert [line.split()[0] for line in ended.out.splitlines()] == ["map", "live"]


def test_a_level_of_warning_keeps_what_needs_a_look(ogm, endpoint):
    command = ogm.mapper("--listen", endpoint, OGM_LOG__LEVEL="warning")
    mapper = ogm.ready(command)
    with RobotPublisher("r1", address=mapper.endpoint) as robot:
        robot.wait_for_mapper(30.0)
        robot.publish_scan([1.0], **SWEEP, stamp=10**18)
        command.complains("a scan is dropped (no_pose)")
    (line,) = command.stop().err.splitlines()
    assert " WARNING ogm_services.mapper" in line


def test_at_debug_the_http_servers_lines_have_the_form_of_ours(ogm):
    mapper = ogm.ready(ogm.mapper("--log-level", "debug", "--log-format", "json"))
    mapper.status()
    lines = [json.loads(line) for line in mapper.command.stop().err.splitlines()]
    assert {line["logger"].partition(".")[0] for line in lines} == {"ogm_services", "uvicorn"}
    assert not any("/status" in line["message"] for line in lines)  # no log of every request


@pytest.mark.parametrize("form", ["text", "json"])
def test_an_error_that_ends_a_mapper_has_the_logs_form(ogm, form):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        ended = ogm.call("mapper", "--http-port", port, "--log-format", form)
    assert ended.code == 1
    last = ended.err.splitlines()[-1]
    told = last.removeprefix("ogm: ") if form == "text" else json.loads(last)["message"]
    assert told.startswith(f"--http-host 127.0.0.1 --http-port {port}: cannot serve")


def test_a_watch_outlives_its_mapper_and_ends_well(ogm, endpoint, eventually):
    first = ogm.ready(ogm.mapper("--listen", endpoint))
    watch = ogm.start("status", "--watch", "0.2", "--json", "--url", endpoint)
    epoch = json.loads(watch.line(r"(\{.*\})$")[1])["epoch"]
    first.command.stop()
    watch.complains(f"ogm: no mapper answers at {endpoint}, trying again\n")
    second = ogm.ready(ogm.mapper("--listen", endpoint))
    other = second.status()["epoch"]
    watch.line(rf'.*"epoch": "{other}"')
    assert other != epoch
    assert watch.stop(signal.SIGINT).code == 0
