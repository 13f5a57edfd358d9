"""A status that was read is the one that was sent; mappers of other versions are understood."""

import json

import pytest

from ogm_client.errors import BadReply
from ogm_core.status import encode_status
from ogm_services.mapper.serving.metrics import prometheus_text
from ogm_services.replies.status_reply import read_status
from status_json import STATUS


def sent():
    return json.loads(encode_status(STATUS))


def test_what_was_sent_is_read():
    assert read_status(sent()) == STATUS
    assert encode_status(read_status(sent())) == encode_status(STATUS)


def test_what_only_a_newer_mapper_says_is_passed_over():
    newer = sent()
    newer["build"] = {"of": "tomorrow"}
    newer["scans"] |= {"lost": 3}
    newer["robots"]["r2"] |= {"battery": 0.5}
    newer["robots"]["r2"]["sources"]["front"] |= {"latency": 0.1}
    newer["scans"]["dropped"] |= {"superseded": 4}
    read = read_status(newer)
    assert read.scans.dropped == {"malformed": 0, "no_pose": 7, "superseded": 4}
    assert read.robots == STATUS.robots
    assert (read.map_info, read.poses) == (STATUS.map_info, STATUS.poses)


def test_reasons_that_an_older_mapper_does_not_know_are_not_needed():
    older = sent()
    older["scans"]["dropped"] = {}
    assert read_status(older).scans.dropped == {}


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("scans",), None, "scans"),
        (("scans", "received"), "many", "scans.received"),
        (("robots", "r2", "pose"), [1.0, 2.0], "robots.r2.pose"),
        (("stamp",), 1.5, "stamp"),
    ],
)
def test_what_is_no_status_is_refused_in_one_line(path, value, said):
    reply = sent()
    inner = reply
    for name in path[:-1]:
        inner = inner[name]
    inner[path[-1]] = value
    with pytest.raises(BadReply, match=rf"^status: {said}.*mapper of another version\?$") as caught:
        read_status(reply)
    assert "\n" not in str(caught.value)
    del inner[path[-1]]
    with pytest.raises(BadReply, match=r"^status: .*: (Field required|Missing)"):
        read_status(reply)


def test_metrics_say_what_the_status_says():
    lines = prometheus_text(STATUS).splitlines()
    samples = [line for line in lines if not line.startswith("#")]
    assert samples == [
        'ogm_scans_received_total{map="hall"} 50',
        'ogm_scans_integrated_total{map="hall"} 41',
        'ogm_scans_pending{map="hall"} 2',
        'ogm_scans_dropped_total{map="hall",reason="malformed"} 0',
        'ogm_scans_dropped_total{map="hall",reason="no_pose"} 7',
        'ogm_poses_received_total{map="hall"} 60',
        'ogm_poses_refused_total{map="hall",reason="malformed"} 1',
        'ogm_poses_refused_total{map="hall",reason="late"} 3',
        'ogm_messages_ignored_total{map="hall"} 5',
        'ogm_map_revision{map="hall"} 41',
        'ogm_map_known_cells{map="hall"} 1234',
        'ogm_map_bytes{map="hall"} 2500000',
        'ogm_robots{map="hall"} 2',
        'ogm_uptime_seconds{map="hall"} 12.25',
    ]
