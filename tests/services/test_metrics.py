"""Metrics for Prometheus say what the status says."""

from ogm_services.mapper.serving.metrics import prometheus_text
from status_json import STATUS


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
        'ogm_poses_refused_total{map="hall",reason="outlier"} 5',
        'ogm_poses_refused_total{map="hall",reason="superseded"} 6',
        'ogm_poses_refused_total{map="hall",reason="refused"} 7',
        'ogm_poses_restarted_total{map="hall"} 2',
        'ogm_poses_ambiguous_total{map="hall"} 4',
        'ogm_messages_ignored_total{map="hall"} 5',
        'ogm_map_revision{map="hall"} 41',
        'ogm_map_known_cells{map="hall"} 1234',
        'ogm_map_bytes{map="hall"} 2500000',
        'ogm_robots{map="hall"} 2',
        'ogm_robot_alive{map="hall",robot="r2"} 1',
        'ogm_robot_alive{map="hall",robot="r1"} 0',
        'ogm_robot_age_seconds{map="hall",robot="r2"} 0.25',
        'ogm_source_scans_dropped_total{map="hall",robot="r2",sensor="front",reason="no_pose"} 5',
        'ogm_source_hint{map="hall",robot="r2",sensor="front",hint="range_max"} 1',
        'ogm_uptime_seconds{map="hall"} 12.25',
    ]
