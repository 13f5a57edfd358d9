"""The rules that promtool checks, and those of the text format, on the metrics of a mapper that works."""

import contextlib
import math
import re
import socket
import time
from collections import Counter

import pytest
from prometheus_client.parser import text_string_to_metric_families

from ogm_services.mapper.serving.http_limits import CLOSED_FOR
from ogm_services.mapper.serving.metrics import Metrics, gauges
from status_json import STATUS

SUFFIXES = {"counter": [""], "gauge": [""], "histogram": ["_bucket", "_sum", "_count"]}
NOT_BASE_UNITS = "milliseconds|microseconds|ms|minutes|hours|kilobytes|megabytes|mb|kb|mib|percent|celsius"
LINE = re.compile(r'([a-zA-Z_:][\w:]*)(\{(?:[a-zA-Z_]\w*="(?:[^"\\\n]|\\[\\"n])*",?)*\})? (\S+)')


def check_rules(text):
    """Assert what `promtool check metrics` asks for, and what the exposition format 0.0.4 does."""
    assert text.endswith("\n")
    kinds, helped, family, seen = {}, set(), None, Counter()
    for line in text.splitlines():
        if line.startswith("# HELP "):
            name, words = line.removeprefix("# HELP ").split(" ", 1)
            assert name not in helped, line
            assert words.strip(), line
            helped.add(name)
        elif line.startswith("# TYPE "):
            name, kind = line.removeprefix("# TYPE ").split(" ")
            assert name not in kinds, line
            assert name in helped, line
            assert (kind == "counter") == name.endswith("_total"), line
            check_name(name, kind)
            kinds[name], family = kind, name
        else:
            match = LINE.fullmatch(line)
            assert match, line
            assert match[1] in [family + suffix for suffix in SUFFIXES[kinds[family]]], line
            seen[match[1], match[2]] += 1
            float(match[3])
    assert kinds.keys() == helped
    assert [series for series, count in seen.items() if count > 1] == []
    for family in text_string_to_metric_families(text):
        if family.type == "histogram":
            check_histogram(family)


def check_name(name, kind):
    assert re.fullmatch(r"[a-z][a-z0-9_]*", name), name
    assert not re.search(rf"_({NOT_BASE_UNITS})(_|$)", name), name
    assert not name.endswith(("_bucket", "_count", "_sum", "_info_total")), name
    assert not any(word in name.split("_") for word in ("counter", "gauge", "histogram")), name
    for unit in ("seconds", "bytes"):  # last, but for _total
        assert unit not in name.split("_") or name.removesuffix("_total").endswith(unit), name


def check_histogram(family):
    series = {}
    for sample in family.samples:
        labels = tuple(sorted((k, v) for k, v in sample.labels.items() if k != "le"))
        series.setdefault(labels, []).append(sample)
    for samples in series.values():
        buckets = [s for s in samples if s.name.endswith("_bucket")]
        edges = [float(s.labels["le"]) for s in buckets]
        counts = [s.value for s in buckets]
        (count,) = [s.value for s in samples if s.name.endswith("_count")]
        (total,) = [s.value for s in samples if s.name.endswith("_sum")]
        assert edges == sorted(set(edges))
        assert edges[-1] == math.inf
        assert counts == sorted(counts)
        assert counts[-1] == count
        assert total >= 0.0


def test_a_working_mapper_keeps_the_rules(mapper):
    before = time.time()
    mapper.draw_cross()
    mapper.put("robots/r/scan/s", b"garbage")
    mapper.settle(received=4)
    for path in ("/map.png", "/nothing", "/quality", "/metrics", "/docs", "/map.png?region=1"):
        mapper.http.get(path)
    text = mapper.http.get("/metrics").text
    check_rules(text)
    values = {
        (
            sample.name,
            sample.labels.get("le"),
            sample.labels.get("route"),
            sample.labels.get("status"),
        ): sample
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if sample.name.startswith(("ogm_scan_", "ogm_last", "ogm_http"))
    }
    value = {key: sample.value for key, sample in values.items()}
    for name in ("ogm_scan_age_seconds", "ogm_scan_integration_seconds"):
        assert value[f"{name}_count", None, None, None] == 3
        assert 0.0 < value[f"{name}_sum", None, None, None] < 3 * 60.0
    assert before <= value["ogm_last_integrated_timestamp_seconds", None, None, None] <= time.time()
    held = {
        sample.labels["kind"]: sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
        if sample.name == "ogm_memory_bytes"
    }
    assert held.keys() >= {"map", "queue", "waiting"}
    assert held["map"] >= mapper.status()["map_info"]["bytes"] > 0
    kinds = dict(line.split(" ")[2:] for line in text.splitlines() if line.startswith("# TYPE "))
    assert kinds["ogm_robot_scans_received_total"] == "counter"
    told = ("ogm_queue_work_limit_seconds", "ogm_queue_scans", "ogm_queue_limit_scans", "ogm_ready")
    assert [kinds[name] for name in told] == ["gauge"] * 4
    assert mapper.http.get("/readyz").status_code == 200
    assert re.search(r'^ogm_ready{map="[^"]*"} 1\.0$', text, re.MULTILINE)
    assert value["ogm_http_requests_total", None, "/map.png", "2xx"] == 1
    assert value["ogm_http_requests_total", None, "/map.png", "4xx"] == 1
    assert value["ogm_http_requests_total", None, "other", "4xx"] == 1
    assert value["ogm_http_request_duration_seconds_count", None, "/map.png", None] == 2
    assert value["ogm_http_requests_total", None, "/metrics", "2xx"] == 1


def test_requests_that_no_route_sees_are_counted_by_what_was_wrong(mapper):
    def counted():
        families = text_string_to_metric_families(mapper.http.get("/metrics").text)
        (family,) = [family for family in families if family.name == "ogm_http_connections_closed"]
        return {sample.labels["reason"]: sample.value for sample in family.samples}

    assert counted() == dict.fromkeys(CLOSED_FOR, 0)
    long, host = b"a" * 70_000, b"Host: localhost\r\n"
    for request in (
        b"GET /" + long + b" HTTP/1.1\r\n",
        b"GET / HTTP/1.1\r\n" + host + b"A: " + long + b"\r\n\r\n",
        b"POST /reset HTTP/1.1\r\n" + host + b"Content-Length: 2000\r\n\r\n",
        b"GET / HTTP/1.1\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + host + host + b"\r\n",
        b"nonsense\r\n\r\n",
    ):
        url = mapper.http.base_url
        with socket.create_connection((url.host, url.port), 30.0) as sock, contextlib.suppress(OSError):
            sock.sendall(request)
            assert sock.recv(12).startswith(b"HTTP/1.1 4")
    wrong = {"uri-too-long": 1, "headers-too-large": 1, "content-too-large": 1, "bad-request": 3}
    assert counted() == dict.fromkeys(CLOSED_FOR, 0) | wrong


def test_a_mapper_without_a_scan_does_not_say_when_the_last_one_came(mapper):
    assert "ogm_last_integrated" not in mapper.http.get("/metrics").text


def test_whatever_stands_in_a_label_ends_none():
    metrics = Metrics(lambda: [gauges("ogm_odd", 'A "help"\n\\ text.', "kind", {'a"b\\c\nd': 1.0})])
    text = metrics.text(STATUS).decode()
    check_rules(text)
    (odd,) = [family for family in text_string_to_metric_families(text) if family.name == "ogm_odd"]
    assert odd.samples[0].labels["kind"] == 'a"b\\c\nd'


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("# TYPE ogm_uptime_seconds gauge", "# TYPE ogm_uptime_seconds counter"),
        ("# HELP ogm_uptime_seconds", "# HELP ogm_uptime_s"),
        ('ogm_scan_age_seconds_bucket{le="+Inf",map="hall"} 0.0', ""),
        (
            'ogm_scan_age_seconds_bucket{le="0.1",map="hall"} 0.0',
            'ogm_scan_age_seconds_bucket{le="0.1",map="hall"} 5.0',
        ),
        (
            'ogm_map_revision{map="hall"} 41.0',
            'ogm_map_revision{map="hall"} 41.0\nogm_map_revision{map="hall"} 41.0',
        ),
        ('ogm_map_revision{map="hall"}', 'ogm_map_revision{map="ha"ll"}'),
        ("ogm_robot_age_seconds", "ogm_robot_age_ms"),
    ],
)
def test_the_rules_find_what_is_wrong(line, instead):
    text = Metrics().text(STATUS).decode()
    assert line in text
    check_rules(text)
    with pytest.raises(AssertionError):
        check_rules(text.replace(line, instead))
