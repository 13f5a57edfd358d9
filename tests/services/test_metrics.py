"""Metrics for Prometheus say what the status says, with as many samples as there are robots, at most."""

import dataclasses
import platform
from importlib.metadata import version

from prometheus_client.parser import text_string_to_metric_families

from ogm_core.placing.receipts import DROP_REASONS
from ogm_core.status import RobotStatus, SourceStatus
from ogm_services.mapper.serving.metrics import Metrics, gauges
from status_json import STATUS


def samples(text):
    """Values by name and labels, in order; without those of the process."""
    found = {}
    for family in text_string_to_metric_families(text.decode()):
        for sample in family.samples:
            if not sample.name.startswith("process_"):
                key = (sample.name, *(f"{name}={value}" for name, value in sample.labels.items()))
                assert key not in found
                found[key] = sample.value
    return found


def of_status(text):
    return {
        key: value
        for key, value in samples(text).items()
        if not key[0].startswith(("ogm_build", "ogm_scan_", "ogm_http", "ogm_live"))
    }


def test_metrics_say_what_the_status_says():
    assert of_status(Metrics().text(STATUS)) == {
        ("ogm_scans_received_total", "map=hall"): 50,
        ("ogm_scans_integrated_total", "map=hall"): 41,
        ("ogm_scans_pending", "map=hall"): 2,
        ("ogm_scans_dropped_total", "map=hall", "reason=malformed"): 0,
        ("ogm_scans_dropped_total", "map=hall", "reason=no_pose"): 7,
        ("ogm_scans_lost_total", "map=hall"): 8,
        ("ogm_scans_replayed_total", "map=hall"): 9,
        ("ogm_beams_on_robots_total", "map=hall"): 12,
        ("ogm_poses_lost_total", "map=hall"): 10,
        ("ogm_poses_replayed_total", "map=hall"): 11,
        ("ogm_poses_received_total", "map=hall"): 60,
        ("ogm_poses_refused_total", "map=hall", "reason=malformed"): 1,
        ("ogm_poses_refused_total", "map=hall", "reason=late"): 3,
        ("ogm_poses_refused_total", "map=hall", "reason=outlier"): 5,
        ("ogm_poses_refused_total", "map=hall", "reason=superseded"): 6,
        ("ogm_poses_refused_total", "map=hall", "reason=refused"): 7,
        ("ogm_poses_restarted_total", "map=hall"): 2,
        ("ogm_poses_ambiguous_total", "map=hall"): 4,
        ("ogm_messages_ignored_total", "map=hall"): 5,
        ("ogm_map_revision", "map=hall"): 41,
        ("ogm_map_known_cells", "map=hall"): 1234,
        ("ogm_map_bytes", "map=hall"): 2_500_000,
        ("ogm_robots", "map=hall"): 2,
        ("ogm_robot_alive", "map=hall", "robot=r2"): 1,
        ("ogm_robot_alive", "map=hall", "robot=r1"): 0,
        ("ogm_robot_age_seconds", "map=hall", "robot=r2"): 0.25,
        ("ogm_robot_scans_received_total", "map=hall", "robot=r2"): 40,
        ("ogm_robot_scans_received_total", "map=hall", "robot=r1"): 0,
        ("ogm_robot_scans_dropped_total", "map=hall", "robot=r2"): 5,
        ("ogm_robot_scans_dropped_total", "map=hall", "robot=r1"): 0,
        ("ogm_robot_hints", "map=hall", "robot=r2"): 1,
        ("ogm_robot_hints", "map=hall", "robot=r1"): 0,
        ("ogm_uptime_seconds", "map=hall"): 12.25,
    }


def test_what_runs_is_said_by_its_versions():
    labels = (f"python={platform.python_version()}", f"version={version('zenoh-ogm')}")
    labels = ("map=hall", labels[0], labels[1], f"zenoh={version('eclipse-zenoh')}")
    assert samples(Metrics().text(STATUS))[("ogm_build_info", *labels)] == 1


def test_the_process_is_measured():
    families = text_string_to_metric_families(Metrics().text(STATUS).decode())
    process = {sample.name: sample.value for family in families for sample in family.samples}
    for name in ("cpu_seconds_total", "resident_memory_bytes", "virtual_memory_bytes", "open_fds", "max_fds"):
        assert process[f"process_{name}"] > 0
    assert process["process_start_time_seconds"] > 1.6e9


def test_a_robot_has_five_samples_however_many_sensors_and_reasons_it_has():
    bad = SourceStatus("a", 1, 99, 0, 0, dict.fromkeys(DROP_REASONS, 3), ["range_max", "stamp"])
    robot = RobotStatus(None, None, age_s=1.0, sources={f"s{number}": bad for number in range(16)})
    status = dataclasses.replace(STATUS, robots={f"r{number}": robot for number in range(1000)})
    found = samples(Metrics().text(status))
    assert sum("robot=r7" in key for key in found) == 5
    assert found[("ogm_robot_scans_received_total", "map=hall", "robot=r7")] == 16 * 99
    assert found[("ogm_robot_scans_dropped_total", "map=hall", "robot=r7")] == 16 * 3 * len(DROP_REASONS)
    assert found[("ogm_robot_hints", "map=hall", "robot=r7")] == 32
    assert len(found) < 5 * 1000 + 100


def test_what_others_hold_is_shown_with_the_rest():
    metrics = Metrics(lambda: [gauges("ogm_memory_bytes", "Held.", "kind", {"map": 7, "queue": 9})])
    found = samples(metrics.text(STATUS))
    assert found[("ogm_memory_bytes", "kind=map", "map=hall")] == 7
    assert found[("ogm_memory_bytes", "kind=queue", "map=hall")] == 9


def test_two_mappers_of_one_process_share_nothing():
    one, other = Metrics(), Metrics()
    one.measurements.scan_integrated(0.0)
    one.measurements.http_answered("/status", "GET", "2xx", 0.1)
    assert samples(one.text(STATUS))[("ogm_scan_age_seconds_count", "map=hall")] == 1
    assert samples(other.text(STATUS))[("ogm_scan_age_seconds_count", "map=hall")] == 0
    assert not any(key[0] == "ogm_http_requests_total" for key in samples(other.text(STATUS)))
