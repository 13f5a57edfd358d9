"""The mapper's monitor: a thread that samples a live map and asks for the truth, until it is stopped."""

import threading

import numpy as np
import pytest

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.quality.figures import map_figures
from ogm_core.simulation.worlds import dump_world, lab, load_world
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live import history as series_module
from ogm_services.mapper.live import monitor as monitor_module
from ogm_services.mapper.live import true_world as true_world_module
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import LOOK_PERIOD, REST, Monitor


class Watched:
    """A live map and its monitor, whose truth is `told`; `asked` counts how often it was asked for."""

    def __init__(self):
        self.live = LiveMap(OccupancyGrid(GridSettings(resolution=0.5), "first"))
        self.monitor = Monitor(self.live)
        self.told = []
        self.asked = 0

    def ask(self):
        self.asked += 1
        return self.told

    def scan(self, distance=2.0, stamp=0):
        beam = Scan(stamp, 0.0, 0.1, 0.0, 8.0, np.array([distance], np.float32))
        self.live.integrate(beam, Pose(0.25, 0.25, 0.0))

    def revisions(self, epoch="first"):
        return self.monitor.series.columns(epoch)["revision"]


@pytest.fixture
def watched(monkeypatch, eventually):
    """A watched map, looked at every few ms; at the end its thread must end, too."""
    monkeypatch.setattr(monitor_module, "LOOK_PERIOD", 0.005)
    monkeypatch.setattr(series_module, "PERIOD", 0.0)
    monkeypatch.setattr(series_module, "REST", 0.0)
    watched = Watched()
    watched.monitor.start(watched.ask)
    yield watched
    watched.monitor.stop()
    assert not {"ogm-monitor", "ogm-truth"} & {thread.name for thread in threading.enumerate()}


def test_it_samples_every_change_that_it_sees_and_nothing_before(watched, eventually):
    assert LOOK_PERIOD == 1.0
    eventually(lambda: watched.asked > 3)
    assert watched.revisions() == []
    for revision in (1, 2, 3):
        watched.scan(1.0 + revision, stamp=revision)
        eventually(lambda: watched.revisions()[-1:] == [revision])  # noqa: B023 - called at once
    asked = watched.asked
    eventually(lambda: watched.asked > asked + 3)
    columns = watched.monitor.series.columns("first")
    figures = map_figures(watched.live.snapshot())
    assert (columns["revision"], columns["stamp"]) == ([1, 2, 3], [1, 2, 3])
    assert {name: columns[name][-1] for name in ("entropy_bits", "mean_entropy_bits", "known_m2")} == {
        name: figures[name] for name in ("entropy_bits", "mean_entropy_bits", "known_m2")
    }


def test_a_reset_begins_a_new_series(watched, eventually):
    watched.scan()
    eventually(watched.revisions)
    watched.live.reset("second")
    assert watched.revisions("second") == []
    eventually(lambda: watched.monitor.series.columns("first")["revision"] == [])
    watched.scan()
    eventually(lambda: watched.revisions("second") == [1])


def test_it_hears_a_world_and_that_it_is_gone(watched, eventually):
    watched.told = [dump_world(lab()).encode()]
    world = eventually(lambda: watched.monitor.truth.world)
    assert world.name == "lab"
    watched.told = []
    eventually(lambda: watched.monitor.truth.world is None)
    watched.monitor.stop()
    assert watched.monitor.truth.world is world


def test_a_look_that_fails_is_logged_and_not_the_last(watched, eventually, caplog):
    watched.told = None
    eventually(lambda: caplog.records)
    watched.told = [dump_world(lab()).encode()]
    eventually(lambda: watched.monitor.truth.world)
    watched.scan()
    eventually(watched.revisions)
    assert {record.getMessage() for record in caplog.records} == {"a look at the map failed"}
    assert caplog.records[0].exc_info[0] is TypeError


def test_while_it_waits_for_the_network_the_map_is_written_and_read(watched, eventually):
    waiting, answered = threading.Event(), threading.Event()

    def ask():
        waiting.set()
        assert answered.wait(30.0)
        return []

    slow = Monitor(watched.live)
    slow.start(ask)
    assert waiting.wait(30.0)
    watched.scan()
    assert watched.live.quality(slow.truth.world)["scans"] == 1
    answered.set()
    slow.stop()


def test_a_world_that_is_still_being_read_holds_nobody_up(watched, monkeypatch, eventually):
    monkeypatch.setattr(monitor_module, "TRUTH_END", 0.01)
    reading, go_on = threading.Event(), threading.Event()

    def read(text):
        reading.set()
        assert go_on.wait(30.0)
        return load_world(text)

    monkeypatch.setattr(true_world_module, "load_world", read)
    slow = Monitor(watched.live)
    slow.start(lambda: [dump_world(lab()).encode()])
    assert reading.wait(30.0)
    watched.scan()
    eventually(lambda: slow.series.columns("first")["revision"] == [1])  # it looks at the map meanwhile
    slow.stop()
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "ogm-truth" and thread.daemon
                 and thread in slow._threads]  # fmt: skip
    go_on.set()
    thread.join(30.0)
    assert not thread.is_alive()
    assert slow.truth.world is None  # what comes after the end does not count


def test_simulators_are_asked_less_often_the_longer_their_worlds_take_to_read(watched, monkeypatch):
    monkeypatch.setattr(monitor_module, "LOOK_PERIOD", 0.0)
    clock = iter(range(1000))
    monkeypatch.setattr(monitor_module.time, "monotonic", lambda: float(next(clock)))
    monitor = Monitor(watched.live)
    monitor._hear(list)
    assert monitor._rest == REST * 1.0 == 10.0


def test_one_that_was_never_started_can_be_stopped():
    Monitor(Watched().live).stop()
