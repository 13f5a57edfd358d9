"""Scans that the queue drops: counted for their source, told of with their rate, not too often."""

import pytest

from ogm_core.placing.receipts import Receipts
from ogm_core.wire.keys import Source
from ogm_services.mapper.intake import overload as overload_module
from ogm_services.mapper.intake.overload import PERIOD, Overload
from ogm_services.mapper.intake.queue import ScanQueue

LASER, OTHER = Source("r", "laser"), Source("r", "other")


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def receipts():
    return Receipts()


@pytest.fixture
def overload(receipts, clock):
    return Overload(ScanQueue(10), receipts, clock)


def lines(caplog):
    return [record.getMessage() for record in caplog.records]


def test_it_is_counted_for_the_source(overload, receipts):
    for robot, sensor in (LASER, LASER, OTHER):
        receipts.scan_received(robot, sensor)
    overload.note([LASER, OTHER, LASER])
    overload.note([])
    sources = receipts.status().robots["r"].sources
    assert [sources[name].dropped for name in ("laser", "other")] == [{"overload": 2}, {"overload": 1}]


def test_the_first_is_told_at_once_and_then_the_rate(overload, clock, caplog):
    overload.note([LASER])
    (line,) = lines(caplog)
    assert line.startswith(
        "r/laser: its oldest scans are dropped (overload): 0 scans, 0 MB, 0.0 s of work wait"
    )
    assert "send fewer scans or beams" in line
    for k in range(1, 101):  # whichever of its sensors
        clock.now = 100.0 + k * PERIOD / 100
        overload.note([OTHER, LASER, LASER])
    assert len(lines(caplog)) == 2
    assert lines(caplog)[1].startswith("r/other: 29.8 of its scans are dropped each second (overload): ")


def test_another_time_is_told_as_the_first(overload, clock, caplog):
    for _ in range(3):
        overload.note([LASER] * 5)
        clock.now += 2 * PERIOD
    assert [line.split(": ")[1] for line in lines(caplog)] == ["its oldest scans are dropped (overload)"] * 3


def test_every_robot_is_told_of(overload, caplog):
    for k in range(50):
        overload.note([Source(f"r{k}", "s")] * 100)
    assert [line.split("/")[0] for line in lines(caplog)] == [f"r{k}" for k in range(50)]


def test_robots_told_of_are_forgotten_in_the_end(overload, monkeypatch):
    monkeypatch.setattr(overload_module, "MAX_ROBOTS", 10)
    for k in range(100):
        overload.note([Source(f"r{k}", "s")])
    assert len(overload._told) == 10
