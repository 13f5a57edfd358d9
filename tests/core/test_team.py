"""Teams: the lines of scans that go into a map in one call, updated by several threads: the map of one."""

import gc
import math
import threading
import weakref

import numba
import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import LimitReached
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Clip, Region
from ogm_core.sensor_models import helper, shared_lines, team, update_threads
from ogm_core.sensor_models import mailbox as mailbox_module
from ogm_core.sensor_models.mailbox import ASLEEP, DONE, EMPTY, FAILED, POSTED, STATE, TAKEN, WORDS
from ogm_core.sensor_models.processors import KeptOff
from ogm_core.sensor_models.update_threads import UpdateThreads
from ogm_core.types import Pose, Scan, Sweep

DEADLINE = 60.0
pytestmark = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT), reason="threads hand each other work in compiled code alone"
)
KINDS = {
    "bresenham": {},
    "bresenham float64": {"cell_model": LogOdds("float64")},
    "dda": {"traversal": "dda"},
    "dda float64": {"traversal": "dda", "cell_model": LogOdds("float64")},
    "clip": {"clip": Clip(-64, None, 64, None)},
    "bounds": {"bounds": Region(-20.0, -15.0, 13.3, 20.0)},
    "bounds drop": {"bounds": Region(-20.0, -15.0, 30.0, 20.0), "outside": "drop", "traversal": "dda"},
}


def scans(count, seed=3, beams=120):
    """Scans all around the origin, each fourth one taken on the way; the first one sees the farthest."""
    rng = np.random.default_rng(seed)
    for k in range(count):
        n = beams - 7 * (k % 3)
        ranges = rng.uniform(0.3, 12.0 if k else 24.0, n).astype(np.float32)
        ranges[rng.random(n) < 0.1] = rng.choice([np.inf, np.nan, 24.0])
        pose = Pose(*rng.uniform(-5.0, 5.0, 2).tolist(), rng.uniform(-4.0, 4.0))
        driven = np.array([pose]) + np.linspace(0.0, 0.3, n)[:, None] * (1.0, 0.5, 0.2)
        scan = Scan(k, -math.pi, math.tau / beams, 0.1, 24.0, ranges)
        yield scan, pose, Sweep(pose, driven) if k % 4 == 3 else None


def grid_of(**changes):
    return OccupancyGrid(GridSettings(**{"resolution": 0.1, "alpha": 0.2, **changes}), "e", "r")


def contents(grid):
    """All that a map holds and tells of itself, bit for bit."""
    tiles = {
        (tile.tx, tile.ty): (tile.revision, {name: cells.tobytes() for name, cells in tile.planes.items()})
        for tile in grid.checkpoint().tiles_since(0)
    }
    return tiles, grid.rect, grid.revision, grid.cell_updates, grid.nbytes


def update_threads_alive():
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("ogm-update-")]


@pytest.fixture(autouse=True)
def always(monkeypatch):
    """Whether it pays or not, scans are shared."""
    monkeypatch.setattr(update_threads, "_LONGEST_REST", 0)


@pytest.fixture
def patient(monkeypatch):
    """Helpers that do not sleep for long: so it is they who do what is posted."""
    monkeypatch.setattr(team, "_PATIENCE", 10**8)


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("kind", KINDS)
def test_the_map_is_that_of_one_thread(kind, count):
    one, many = grid_of(**KINDS[kind]), grid_of(**KINDS[kind])
    shared = 0
    with UpdateThreads(count, least_cells=1) as many.threads:
        for placed in scans(60):
            assert many.integrate(*placed) == one.integrate(*placed)
            shared += many.threads._team is not None and many.threads._team.times is not None
            assert many.threads._team is None or not many.threads._team._marks.any()
    assert contents(many) == contents(one)
    assert shared > 30
    assert not update_threads_alive()


def known_maps(threads, **changes):
    """A map of one thread, one of several, of the same scans; a scan that these share from now on."""
    one, many, placed = grid_of(**changes), grid_of(**changes), list(scans(3))
    many.threads = threads
    for scan in [*placed, placed[1], placed[1]]:
        assert many.integrate(*scan) == one.integrate(*scan)
    assert threads._team is not None
    return one, many, placed[1]


@pytest.mark.parametrize("traversal", ["bresenham", "dda"])
def test_helpers_update_their_parts(traversal, patient, eventually):
    with UpdateThreads(3, least_cells=1) as threads:
        one, many, placed = known_maps(threads, traversal=traversal)
        done_by_helpers = threads._team._mailboxes[:, shared_lines._UPDATES]
        done_by_helpers[:] = 0

        def all_have():
            assert many.integrate(*placed) == one.integrate(*placed)
            return bool(done_by_helpers.all())

        assert eventually(all_have)
    assert contents(many) == contents(one)
    assert not update_threads_alive()


@pytest.mark.parametrize("traversal", ["bresenham", "dda"])
def test_no_part_reaches_beyond_bounds_within_a_tile(traversal, patient):
    """Most of the beams' columns are outside, in the tile through which the map's right edge runs."""
    one, many = (grid_of(traversal=traversal, bounds=Region(-20.0, -15.0, 13.3, 20.0)) for _ in range(2))
    ranges = np.linspace(4.0, 5.0, 120).astype(np.float32)
    scan, pose = Scan(0, -0.5, 1.0 / 120, 0.1, 24.0, ranges), Pose(12.9, 0.0, 0.0)
    with UpdateThreads(3, least_cells=1) as many.threads:
        for _ in range(40):
            assert many.integrate(scan, pose) == one.integrate(scan, pose)
        assert many.threads._team is not None
    assert contents(many) == contents(one)


def test_helpers_fall_asleep_and_let_go_of_a_map_that_began_anew(eventually):
    with UpdateThreads(3, least_cells=1) as threads:
        _, grid, placed = known_maps(threads)
        for _ in range(50):
            grid.integrate(*placed)
        store = weakref.ref(grid._store)
        eventually(lambda: (threads._team._mailboxes[:, STATE] == ASLEEP).all())
        grid.reset("f")
        eventually(lambda: gc.collect() >= 0 and store() is None)
        for placed in scans(20):
            grid.integrate(*placed)
        assert update_threads_alive() == ["ogm-update-1", "ogm-update-2"]
    assert not update_threads_alive()


def test_small_scans_start_no_thread():
    grid = grid_of()
    with UpdateThreads(2) as grid.threads:
        for placed in scans(10):
            grid.integrate(*placed)
        assert grid.cell_updates > 10_000
        assert not update_threads_alive()


def test_a_part_for_which_a_helper_has_no_memory_is_updated_by_the_caller(patient, monkeypatch, eventually):
    failed = []

    def serve(mailbox, patience, *_):
        if mailbox_module.taken(mailbox, patience):
            failed.append(mailbox)
            raise MemoryError

    monkeypatch.setattr(team.shared_lines, "serve", serve)
    with UpdateThreads(2, least_cells=1) as threads:
        one, many, placed = known_maps(threads)

        def has_failed():
            assert many.integrate(*placed) == one.integrate(*placed)
            return len(failed) > 1

        eventually(has_failed)
    assert contents(many) == contents(one)


@pytest.mark.parametrize("before_it_begins", [True, False])
def test_another_takes_the_place_of_a_helper_that_an_error_has_ended(
    before_it_begins, patient, monkeypatch, eventually
):
    """Whatever it was: in its work, or on the way to it."""
    ended, serve = [], shared_lines.serve

    def failing(mailbox, patience, *rest):
        if ended or before_it_begins:
            serve(mailbox, patience, *rest)
        elif mailbox_module.taken(mailbox, patience):
            raise RuntimeError("odd")

    def leaving(_):
        if before_it_begins and not ended:
            raise RuntimeError("odd")

    monkeypatch.setattr(team.shared_lines, "serve", failing)
    monkeypatch.setattr(helper, "keep_off", lambda _: KeptOff(set(), set()))
    monkeypatch.setattr(helper, "let_back", leaving)
    monkeypatch.setattr(threading, "excepthook", lambda error: ended.append(str(error.exc_value)))
    with UpdateThreads(2, least_cells=1) as threads:
        one, many, placed = known_maps(threads)

        def all_is_well():
            assert many.integrate(*placed) == one.integrate(*placed)
            return bool(ended) and threads._team._mailboxes[:, shared_lines._UPDATES].all()

        assert eventually(all_is_well)
        assert update_threads_alive() == ["ogm-update-1"]
    assert ended == ["odd"]
    assert contents(many) == contents(one)
    assert not update_threads_alive()


@pytest.mark.parametrize(
    ("state", "error"),
    [(EMPTY, LimitReached), (ASLEEP, LimitReached), (POSTED, RuntimeError), (DONE, RuntimeError)],
)
def test_a_call_that_fails_is_refused_unless_others_may_have_written(state, error, monkeypatch):
    with UpdateThreads(2, least_cells=1) as threads:
        _, grid, placed = known_maps(threads)
        before, mailboxes = grid.revision, np.zeros((1, WORDS), np.int64)

        def fail(*_):
            mailboxes[0, STATE] = state
            raise MemoryError

        monkeypatch.setattr(grid._one_call, "_kernel", fail)
        monkeypatch.setattr(threads._team, "_mailboxes", mailboxes)
        with pytest.raises(
            error, match="no memory left" if error is LimitReached else "in a part of the map only"
        ):
            grid.integrate(*placed)
        assert grid.revision == before
        assert mailboxes[0, STATE] in (EMPTY, ASLEEP)


@pytest.mark.parametrize(
    ("took", "expected"), [(0.8, list(range(16))), (0.9, [*range(4), *range(5, 9), *range(12, 16)])]
)
def test_where_a_team_does_not_pay_one_thread_goes_on_alone(took, expected, monkeypatch):
    """It is tried four times, and again after 1 scan, 3, 7 and so on."""
    monkeypatch.setattr(team.Team, "times", (took, 1.0))
    with UpdateThreads(2, least_cells=1) as threads:
        _, grid, placed = known_maps(threads)
        threads._misses = 0
        monkeypatch.setattr(update_threads, "_LONGEST_REST", 127)
        asked, team_of = [], threads.team

        def noted(*arguments):
            found = team_of(*arguments)
            if found is not None:
                asked.append(grid.revision - begun)
            return found

        threads.team, begun = noted, grid.revision
        for _ in range(16):
            grid.integrate(*placed)
    assert asked == expected


def box(state):
    mailbox = np.zeros(WORDS, np.int64)
    mailbox[STATE] = state
    return mailbox


def test_what_is_posted_is_taken_and_who_has_waited_long_enough_sleeps():
    posted, empty = box(POSTED), box(EMPTY)
    assert mailbox_module.taken(posted, 0)
    assert posted[STATE] == TAKEN
    assert not mailbox_module.taken(empty, 1000)
    assert empty[STATE] == ASLEEP


@pytest.mark.parametrize(
    ("before", "done", "after"),
    [
        (POSTED, False, EMPTY),
        (DONE, True, EMPTY),
        (ASLEEP, False, ASLEEP),
        (FAILED, False, FAILED),
        (EMPTY, False, EMPTY),
    ],
)
def test_what_nobody_has_done_is_the_givers_to_do(before, done, after):
    mailbox = box(before)
    assert mailbox_module.done(mailbox) is done
    assert mailbox[STATE] == after


def test_the_giver_waits_for_what_is_taken():
    mailbox, found = box(TAKEN), []
    mailbox_module.done(box(DONE))  # compiled
    giver = threading.Thread(target=lambda: found.append(mailbox_module.done(mailbox)))
    giver.start()
    giver.join(0.05)
    assert giver.is_alive()
    mailbox[STATE] = DONE
    giver.join(DEADLINE)
    assert found == [True]
