"""The map while it is written: snapshots are whole and shared, figures are computed rarely."""

import math
import threading
from types import SimpleNamespace

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.quality.bounded import bounded_figures
from ogm_core.quality.figures import Consistency, map_figures
from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.worlds import lab, load_world
from ogm_core.status import MapInfo
from ogm_core.tiles.polygon import Polygon
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live import live_figures as live_figures_module
from ogm_services.mapper.live.identity import Identity
from ogm_services.mapper.live.live_figures import FIGURES_PERIOD, PATIENT_PERIOD
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.recent_scans import RECENT_SCANS
from ogm_services.replies.answer import Unavailable

HERE = Pose(0.25, 0.25, 0.0)
SETTINGS = GridSettings(resolution=0.5)
MADE = [
    SETTINGS,
    GridSettings(resolution=0.5, cell_model=LogOdds(cells="float64")),
    GridSettings(resolution=0.5, bounds=Region(-9.0, -9.0, 99.0, 9.0)),
]


def scan(distance=2.0, stamp=0):
    """One beam to the east."""
    return Scan(stamp, 0.0, 0.1, 0.0, 8.0, np.array([distance], np.float32))


@pytest.fixture
def live():
    return LiveMap(OccupancyGrid(SETTINGS, "first"))


@pytest.fixture
def clock(monkeypatch):
    """The clock that a live map reads: `clock.now`, s."""
    clock = SimpleNamespace(now=1000.0)
    monkeypatch.setattr(live_figures_module, "time", SimpleNamespace(monotonic=lambda: clock.now))
    return clock


@pytest.fixture
def counted(monkeypatch):
    """How often the figures of a whole map are computed: a list of their revisions."""
    revisions = []

    def count(snapshot, *others):
        revisions.append(snapshot.revision)
        return bounded_figures(snapshot, *others)

    monkeypatch.setattr(live_figures_module, "bounded_figures", count)
    return revisions


def test_a_snapshot_is_the_same_object_until_the_map_changes(live):
    empty = live.snapshot()
    assert live.snapshot() is empty
    live.integrate(scan(), HERE)
    first = live.snapshot()
    assert live.snapshot() is first is not empty
    assert (empty.revision, empty.width, first.revision, first.width) == (0, 0, 1, 4)
    live.reset("second")
    assert (live.snapshot().epoch, live.snapshot().revision, live.snapshot().width) == ("second", 0, 0)


def test_a_snapshot_does_not_change_when_the_map_does(live):
    live.integrate(scan(), HERE)
    first = live.snapshot()
    cells = first.cells.copy()
    live.integrate(scan(), HERE)
    live.integrate(scan(7.0), HERE)
    live.reset("second")
    np.testing.assert_array_equal(first.cells, cells)
    assert (first.epoch, first.revision) == ("first", 1)


def test_the_map_is_its_grid(live):
    twin = OccupancyGrid(SETTINGS, "first")
    for stamp in (5, 9, 7):
        assert live.integrate(scan(1 + stamp / 4, stamp), HERE) == twin.integrate(
            scan(1 + stamp / 4, stamp), HERE
        )
    assert live.snapshot().cells.tobytes() == twin.snapshot().cells.tobytes()
    assert live.now == Identity(epoch="first", run="", revision=3, stamp=9)
    assert live.info() == MapInfo(
        known_cells=live.info().known_cells,
        bytes=twin.nbytes,
        width=twin.rect.width,
        height=1,
        resolution=0.5,
    )


def test_a_scan_that_is_refused_leaves_everything_as_it_was(live):
    live.integrate(scan(), HERE)
    before, identity, quality = live.snapshot(), live.now, live.quality()
    with pytest.raises(LimitReached):
        live.integrate(scan(), Pose(1e9, 1e9, 0.0))
    assert live.snapshot() is before
    assert live.now == identity
    assert live.quality() is quality


def test_quality_is_computed_at_most_once_a_second(live, clock, counted):
    assert FIGURES_PERIOD == 1.0
    first = live.quality()
    assert (first["scans"], counted) == (0, [0])
    live.integrate(scan(), HERE)
    clock.now += 0.999
    assert live.quality() is first
    clock.now += 0.001
    second = live.quality()
    assert (second["scans"], second["known_m2"], counted) == (1, 1.0, [0, 1])
    live.integrate(scan(), HERE)
    assert live.quality() is second
    clock.now += 0.5
    assert live.quality() is second
    clock.now += 0.5
    assert (live.quality()["scans"], counted) == (2, [0, 1, 2])


def test_quality_of_a_map_that_does_not_change_is_computed_once(live, clock, counted):
    live.integrate(scan(), HERE)
    for _ in range(5):
        live.quality()
        clock.now += 60.0
    assert counted == [1]
    live.reset("second")
    assert live.quality()["scans"] == 0
    assert counted == [1, 0]


def test_known_cells_may_be_old_and_the_size_is_not(live, clock):
    assert (live.info().known_cells, live.info().width) == (0, 0)
    live.integrate(scan(), HERE)
    assert (live.info().known_cells, live.info().width) == (0, 4)
    clock.now += 2.9
    assert live.info().known_cells == 0
    clock.now += 0.1
    assert live.info().known_cells == 4
    live.integrate(scan(3.0), HERE)
    assert live.quality()["known_m2"] == 6 * 0.25  # each figure has a second of its own
    assert live.info().known_cells == 4


def test_known_cells_are_counted_once_a_second_at_most_for_those_who_do_not_ask(live, clock):
    live.count_known()
    live.integrate(scan(), HERE)
    live.count_known()
    assert live.info().known_cells == 0
    clock.now += 1.0
    live.count_known()
    assert live.info().known_cells == 4


def test_quality_is_that_of_the_map_and_of_its_scans(live):
    live.integrate(scan(2.0), HERE)
    live.integrate(scan(1.0), HERE)
    quality = live.quality()
    # Cells 1 to 4: free twice; free and then hit, back at a half; free; hit.
    expected = map_figures(live.snapshot()) | {"consistency": {}, "scans": 2, "cell_updates": 6}
    whole = {"map": 1.0, "scans": 2, "consistency": 1.0, "truth": None, "visits": 4 + 4 + 4 + 2}
    assert {**quality, "consistency": {}} == expected | {"judged": whole, "truth": None}
    assert (quality["known_m2"], quality["free_m2"], quality["occupied_m2"]) == (1.0, 0.25, 0.25)
    # One of two hits ended, and one of four passes went through, where p is a half.
    assert quality["consistency"] == {"hits": 0.5, "free": 0.75}


def test_consistency_is_that_of_the_last_hundred_scans(live, clock):
    assert RECENT_SCANS == 100
    live.integrate(scan(1.0), Pose(0.25, 9.25, 0.0))  # a wall elsewhere ...
    for _ in range(9):
        live.integrate(scan(2.0), Pose(0.25, 9.25, 0.0))  # ... that is gone
    for _ in range(90):
        live.integrate(scan(), HERE)
    # The wall that is gone is the only hit in a cell that is not occupied.
    assert live.quality()["consistency"] == {"hits": 0.99, "free": 1.0}
    live.integrate(scan(), HERE)
    clock.now += 1.0
    assert live.quality()["consistency"] == {"hits": 1.0, "free": 1.0}
    assert live.quality()["scans"] == 101
    live.reset("second")
    clock.now += 1.0
    assert live.quality()["consistency"] == {"hits": None, "free": None}
    live.integrate(scan(1.0), HERE)  # where the scans before the reset had passed
    clock.now += 1.0
    assert live.quality()["consistency"] == {"hits": 1.0, "free": 1.0}


@pytest.mark.parametrize("settings", MADE, ids=["int16", "float64", "bounds"])
def test_readers_get_whole_maps_while_it_is_written(settings, eventually):
    steps = [(scan(1.0 + step % 7 / 2, step), Pose(step / 4, step % 3 / 2, step / 9)) for step in range(150)]
    twin = OccupancyGrid(settings, "first")
    maps = {0: twin.snapshot()}
    for each in steps:
        twin.integrate(*each)
        maps[twin.revision] = twin.snapshot()
    live, done, wrong = LiveMap(OccupancyGrid(settings, "first")), threading.Event(), []

    def read(seen):
        last = 0
        while not done.is_set():
            snapshot = live.snapshot()
            same = maps[snapshot.revision]
            if snapshot.revision < last or snapshot.offset != same.offset or snapshot.stamp != same.stamp:
                wrong.append(snapshot.revision)
            if snapshot.cells.tobytes() != same.cells.tobytes():
                wrong.append(snapshot.revision)
            last = snapshot.revision
            seen.add(last)
            live.quality()

    views = [set() for _ in range(3)]
    readers = [threading.Thread(target=read, args=(seen,)) for seen in views]
    for reader in readers:
        reader.start()
    for count, each in enumerate(steps):
        live.integrate(*each)
        if count % 10 == 9:  # all go on beside the next ten, from wherever they are
            eventually(lambda now=count + 1: wrong or all(now in seen for seen in views))
    done.set()
    for reader in readers:
        reader.join(30.0)
    assert wrong == []
    assert all(len(seen) >= 15 for seen in views)
    assert live.snapshot().cells.tobytes() == maps[150].cells.tobytes()


def test_after_a_reset_no_figure_is_the_old_maps(live, clock):
    live.integrate(scan(), HERE)
    assert live.info().known_cells == 4
    assert live.quality()["known_m2"] == 1.0
    live.reset("second")
    assert live.info().known_cells == 0
    assert live.quality()["known_m2"] == 0.0


def test_after_a_reset_nobody_gets_what_another_still_counts(live, clock, in_background, monkeypatch):
    counting, go_on = threading.Event(), threading.Event()
    live.integrate(scan(), HERE)
    assert live.info().known_cells == 4
    count = live._figures._known_cells_now

    def slow():
        counting.set()
        assert go_on.wait(10.0)
        return count()

    monkeypatch.setattr(live._figures, "_known_cells_now", slow)
    live.integrate(scan(), HERE)
    clock.now += 60.0
    counter = in_background(live.count_known)
    assert counting.wait(10.0)
    assert live.info().known_cells == 4  # of a moment ago: who asks does not wait
    live.reset("second")
    asked = in_background(live.info)
    go_on.set()
    counter.result(10.0)
    assert asked.result(10.0).known_cells == 0


def test_truth_is_that_of_the_map_and_the_world(live, clock):
    live.integrate(scan(2.0), HERE)
    world = load_world("{walls: [[2.1, 0.1, 2.1, 0.4]], path: {circle: [0, 0, 1], poses: 4}}")
    truth = live.quality(world)["truth"]
    assert truth == truth_figures(live.snapshot(), world)
    # Its one wall stands where the map has its one hit, behind three free cells.
    shares = {"accuracy": 1.0, "precision": 1.0, "recall": 1.0, "iou": 1.0}
    assert truth == {**shares, "log_loss": pytest.approx(-math.log(0.7), rel=1e-3)}


def test_another_world_is_another_quality_of_the_same_map(live, clock, counted):
    live.integrate(scan(2.0), HERE)
    worlds = lab(), lab()
    first = live.quality(worlds[0])
    assert live.quality(worlds[1]) is first  # less than a second later
    clock.now += 1.0
    assert live.quality(worlds[0]) is first
    second = live.quality(worlds[1])
    assert second is not first
    clock.now += 1.0
    assert live.quality(worlds[1]) is second
    assert live.quality(None)["truth"] is None
    assert counted == [1, 1, 1]


def test_the_figures_after_an_erasure_are_those_of_what_is_left_and_of_later_scans(live, clock):
    """A hit in a cell that was erased says nothing against the map."""
    live.integrate(scan(), HERE)
    live.integrate(scan(), HERE)
    assert live.quality()["consistency"] == {"hits": 1.0, "free": 1.0}
    assert live.erase(Polygon.of_region(Region(2.0, 0.0, 2.5, 0.5), SETTINGS.lattice)) == 1
    clock.now += PATIENT_PERIOD
    quality = live.quality()
    assert (quality["scans"], quality["cell_updates"], quality["known_m2"]) == (2, 8, 0.75)
    assert quality["consistency"] == {"hits": None, "free": None}
    assert (live.info().known_cells, live.info().width, live.now.revision) == (3, 3, 3)
    live.integrate(scan(), HERE)
    clock.now += 1.0
    assert live.quality()["consistency"] == {"hits": 1.0, "free": 1.0}
    assert live.quality()["scans"] == 3


def test_a_fresh_quality_is_never_an_old_one(live, clock):
    assert live.quality()["scans"] == 0
    live.integrate(scan(), HERE)
    assert (live.quality()["scans"], live.fresh_quality()["scans"]) == (0, 1)
    assert live.fresh_quality(lab())["truth"]["accuracy"] is not None


def test_figures_that_are_late_are_none_and_named(live):
    live.integrate(scan(), HERE)
    whole = live.fresh_quality(lab(), within=60.0)
    assert "missing" not in whole
    assert whole["consistency"]["hits"] == 1.0
    late = live.fresh_quality(lab(), within=0.0)
    nothing = {"consistency": {"hits": None, "free": None}, "truth": None}
    assert late == {**whole, **nothing, "missing": ["consistency", "truth"]}
    assert live.fresh_quality(within=0.0)["missing"] == ["consistency"]


def test_a_share_of_some_of_the_beams_is_none_either(live, clock, monkeypatch):
    live.integrate(scan(), HERE)
    live.integrate(scan(), HERE)
    judged, add = [], Consistency.add

    def slow(consistency, placed, between):
        add(consistency, placed, between)
        judged.append(consistency.figures()["hits"])
        clock.now += 1.0

    monkeypatch.setattr(Consistency, "add", slow)
    late = live.fresh_quality(lab(), within=0.5)
    assert (judged, late["consistency"]["hits"]) == ([1.0], None)
    assert (late["missing"], late["truth"] is None) == (["consistency"], False)


def test_nobody_waits_for_figures_of_a_map_that_stops(live):
    live.integrate(scan(), HERE)
    live.stop()
    with pytest.raises(Unavailable, match="the mapper is stopping"):
        live.quality()
    assert live.fresh_quality()["consistency"]["hits"] == 1.0
