"""A stamp or seq near 2^63 costs that message, or what waits at its time, and nothing after it."""

import numpy as np
import pytest

from mapper_desk import MS, T0, Desk, Sink
from ogm_core.logs.recordings import RecordedPose, RecordedScan, RecordingReader, write_jsonl
from ogm_core.types import IDENTITY, Pose, PoseStamped, Scan
from ogm_services.commands.log_feed import LogFeed
from ogm_services.settings.settings import Settings

LAST = 2**63 - 1
NOW = T0 + 1000 * MS
"""About when the odd message comes."""
ODD = [(LAST, 5), (LAST, LAST), (NOW, LAST), (LAST - 10**9, 6), (LAST, 110)]


def scan_of(stamp, seq, beams=1, **fields):
    return Scan(stamp, 0.0, 0.1, 0.0, 8.0, np.ones(beams, np.float32), seq=seq, run="a", **fields)


def drive_with(odd):
    """20 poses and scans, 100 ms apart, and `odd` in the midst of them."""
    messages = []
    for k in range(20):
        if k == 10:
            messages.append(odd)
        messages.append(RecordedScan("r", "s", scan_of(T0 + 100 * k * MS, 100 + k)))
        messages.append(
            RecordedPose("r", PoseStamped(T0 + 100 * k * MS, Pose(0.0, 0.01 * k, 0.0), 100 + k, "a"))
        )
    return messages


def played(desk, messages):
    for message in messages:
        if isinstance(message, RecordedScan):
            desk.received += 1
            desk.receipts.scan_received("r", "s", desk.now)
            desk.placer.add_scan("r", "s", message.message, desk.now)
        else:
            desk.receipts.pose_received("r", desk.now)
            desk.placer.add_pose("r", message.message, desk.now)
        desk.check()
    return desk


def read(path, messages, settings=None):
    """What comes of a log of these: the sink's scans, and the status."""
    write_jsonl(path, messages)
    sink, feed = Sink(), LogFeed(settings or Settings())
    sink.withheld = set()
    with RecordingReader(path) as reader:
        feed.run(reader, sink, "reading")
    return sink, feed.receipts.status()


@pytest.mark.parametrize(("stamp", "seq"), ODD)
def test_of_scans_only_the_odd_one_is_lost(tmp_path, stamp, seq):
    messages = drive_with(RecordedScan("r", "s", scan_of(stamp, seq)))
    desk = played(Desk(), messages)
    expected = [100 + k for k in range(20) if (seq, k) != (110, 10)]  # that number was used up
    assert [n for n in desk.order if n != seq] == expected
    lost = (stamp != NOW) + (seq == 110)  # a far seq with a stamp of its time is placed
    assert (len(desk.order), desk.pending, sum(desk.dropped.values())) == (21 - lost, 0, lost)
    sink, status = read(tmp_path / "log.jsonl", messages)
    assert [n for n, _ in sink.placed] == desk.order
    assert {reason: n for reason, n in status.scans.dropped.items() if n} == desk.dropped


@pytest.mark.parametrize(("stamp", "seq"), ODD)
def test_after_an_odd_pose_every_scan_that_has_its_own_is_placed_by_it(tmp_path, stamp, seq):
    messages = drive_with(RecordedPose("r", PoseStamped(stamp, Pose(50.0, 0.0, 0.0), seq, "a")))
    desk = played(Desk(), messages)
    assert set(desk.order) >= {100 + k for k in range(20) if not 9 <= k <= 15}
    assert [y for _, (_, y, _) in desk.sink.placed] == [0.01 * (seq - 100) for seq in desk.order]
    assert desk.xs == [0.0] * len(desk.order)
    sink, status = read(tmp_path / "log.jsonl", messages)
    assert sink.placed == desk.sink.placed
    assert status.scans.dropped == desk.receipts.status().scans.dropped
    assert status.scans.pending == 0


def test_a_scan_whose_last_beam_is_ages_away_is_lost_alone():
    desk = Desk()
    for k, step in enumerate((1e9, 1e200, -1e200, 1e9)):
        desk.pose(100 * k, run="a", seq=k)
        desk.receipts.scan_received("r", "s", 0.0)
        desk.received += 1
        desk.placer.add_scan("r", "s", scan_of(T0 + 100 * k * MS, k, beams=3, time_increment=step), 0.0)
    desk.pose(400, run="a", seq=4).scan(350, run="a", seq=9)
    assert desk.order == [9]
    desk.placer.expire(10.0)
    assert (sum(desk.dropped.values()), desk.pending) == (4, 0)


@pytest.mark.parametrize(("offset", "malformed"), [(1.0, 1), (4e9, 1), (-1.0, 0), (-4e9, 0)])
def test_a_time_offset_of_such_a_stamp_is_lost_or_placed_and_harms_no_other(tmp_path, offset, malformed):
    settings = Settings.model_validate({"sensors": [{"match": "r/*", "time_offset": offset}]})
    messages = [
        RecordedScan("r", "s", scan_of(stamp, k, pose=IDENTITY)) for k, stamp in enumerate((5, LAST, 6))
    ]
    sink, status = read(tmp_path / "log.jsonl", messages, settings)
    assert status.scans.dropped["malformed"] == malformed
    assert [seq for seq, _ in sink.placed] == ([0, 2] if malformed else [0, 1, 2])
