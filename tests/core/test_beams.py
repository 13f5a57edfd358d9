"""Which beams count and where they end (REP-117, in the order of the design's rules)."""

import itertools
import math

import numba
import numpy as np
import pytest

import naive
from ogm_core.errors import LimitReached
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Lattice
from ogm_core.sensor_models import beams
from ogm_core.sensor_models.beams import HIT, NO_RETURN, SKIPPED
from ogm_core.sensor_models.projection import Beams, beam_model, directions, project, read_only
from ogm_core.types import PlacedScan, Pose, Scan

NAN, INF = math.nan, math.inf
R_MIN, R_MAX, ALPHA = 0.5, 8.0, 0.25
SOFT = R_MAX - ALPHA / 2  # 7.875, exact in float32 too
BELOW_SOFT, BELOW_MAX = math.nextafter(SOFT, 0), math.nextafter(R_MAX, 0)

NO_EVIDENCE = SKIPPED, 0.0

COMPILED = pytest.mark.skipif(
    bool(numba.config.DISABLE_JIT),
    reason="cos of an infinite angle: NaN where it is compiled, in Python an error",
)


def scan_of(ranges, **changes):
    values = {"stamp": 1, "angle_min": -1.0, "angle_increment": 0.3, "range_min": 0.0, "range_max": R_MAX}
    return Scan(**{**values, "ranges": np.asarray(ranges, np.float32), **changes})


def cells_of(scan, pose, lattice, settings):
    """End cell and kind of every beam, and its start cell: five rows."""
    return project(PlacedScan(scan, pose), lattice, settings).ends


def classify(r, range_min, range_max, alpha, clear_range, reach):
    """By the rules, and by the arithmetic that makes them one expression."""
    model = beams.BeamModel(0.0, 0.1, range_min, range_max, alpha, clear_range, reach)
    kind, length = beams.classify(r, model)
    counts, hit, same_length = beams.reading(r, model)
    assert (counts + hit, same_length) == (kind, length)
    return kind, length


@pytest.mark.parametrize(
    ("r", "clear_range", "reach", "expected"),
    [
        (NAN, INF, INF, NO_EVIDENCE),
        (-INF, INF, INF, NO_EVIDENCE),
        (-1.0, INF, INF, NO_EVIDENCE),
        (0.0, INF, INF, NO_EVIDENCE),
        (-0.0, INF, INF, NO_EVIDENCE),
        (math.nextafter(R_MIN, 0), INF, INF, NO_EVIDENCE),
        (R_MIN, INF, INF, (HIT, R_MIN)),
        (3.0, INF, INF, (HIT, 3.0)),
        (BELOW_SOFT, INF, INF, (HIT, BELOW_SOFT)),
        (SOFT, INF, INF, (NO_RETURN, SOFT)),
        (7.9, INF, INF, (NO_RETURN, 7.9)),
        (BELOW_MAX, INF, INF, (NO_RETURN, BELOW_MAX)),
        (R_MAX, INF, INF, (NO_RETURN, R_MAX)),
        (9.0, INF, INF, (SKIPPED, 0.0)),
        (81.83, INF, INF, (SKIPPED, 0.0)),
        (8.000007, INF, INF, (NO_RETURN, R_MAX)),
        (8.000009, INF, INF, (SKIPPED, 0.0)),
        (INF, INF, INF, (NO_RETURN, R_MAX)),
        # clear_range shortens what saw nothing, never a hit.
        (INF, 3.0, INF, (NO_RETURN, 3.0)),
        (7.9, 3.0, INF, (NO_RETURN, 3.0)),
        (7.9, 7.95, INF, (NO_RETURN, 7.9)),
        (5.0, 3.0, INF, (HIT, 5.0)),
        (INF, 0.0, INF, (NO_RETURN, 0.0)),
        (INF, 20.0, INF, (NO_RETURN, R_MAX)),
        # reach shortens everything; a hit beyond it frees the cells up to it, whatever clear_range says.
        (INF, INF, 4.0, (NO_RETURN, 4.0)),
        (7.9, INF, 4.0, (NO_RETURN, 4.0)),
        (5.0, INF, 4.0, (NO_RETURN, 4.0)),
        (5.0, 3.0, 4.0, (NO_RETURN, 4.0)),
        (4.0, 3.0, 4.0, (HIT, 4.0)),
        (math.nextafter(4.0, 5), 3.0, 4.0, (NO_RETURN, 4.0)),
        (INF, 3.0, 4.0, (NO_RETURN, 3.0)),
        (INF, 3.0, 2.0, (NO_RETURN, 2.0)),
        (5.0, INF, 20.0, (HIT, 5.0)),
    ],
)
def test_the_first_rule_that_fits_wins(r, clear_range, reach, expected):
    assert classify(r, R_MIN, R_MAX, ALPHA, clear_range, reach) == expected


def test_classify_is_its_twin_on_every_boundary():
    edges = (0.0, 0.5, 3.0, 7.0, SOFT, R_MAX, 20.0)
    readings = [NAN, INF, -INF, -1.0, -0.0, 5e-324]
    readings += [side for r in edges for side in (r, math.nextafter(r, INF), math.nextafter(r, -INF))]
    limits = itertools.product(
        readings, (0.0, 0.5), (0.0, ALPHA, 30.0), (0.0, 3.0, 7.0, INF), (3.0, 7.95, R_MAX, INF)
    )
    for r, range_min, alpha, clear_range, reach in limits:
        kind, length = classify(r, range_min, R_MAX, alpha, clear_range, reach)
        found = None if kind == SKIPPED else (kind == HIT, length)
        expected = naive.classify(r, range_min, R_MAX, alpha, clear_range, reach)
        assert found == expected, (r, range_min, alpha, clear_range, reach)


def test_without_thickness_every_range_below_range_max_is_a_hit():
    assert classify(BELOW_MAX, 0.0, R_MAX, 0.0, INF, INF) == (HIT, BELOW_MAX)
    assert classify(R_MAX, 0.0, R_MAX, 0.0, INF, INF) == (NO_RETURN, R_MAX)


@pytest.mark.parametrize("increment", [0.013, -0.013, 7.0])
@pytest.mark.parametrize("anchor", [(0.0, 0.0), (-3.7, 12.1)])
@pytest.mark.parametrize("theta", [17.0, 1e15])  # the order of the sum shows in a heading of 1e15
def test_end_cells_are_the_cells_of_the_end_points(increment, anchor, theta):
    rng = np.random.default_rng(1)
    lattice = Lattice(0.07, anchor)
    pose = Pose(-4.3, 2.2, theta)
    ranges = rng.uniform(0.1, 9, 500).astype(np.float32)
    ranges[::50] = NAN
    scan = scan_of(ranges, angle_min=-1.06, angle_increment=increment)
    ends = cells_of(scan, pose, lattice, GridSettings(alpha=0.2, clear_range=5.0, reach=7.0))
    start = lattice.cell_of(pose.x, pose.y)
    assert {0, 1, 2} == set(ends[2].tolist())
    for k, reading in enumerate(ranges.tolist()):
        beam = naive.classify(reading, 0.0, R_MAX, 0.2, 5.0, 7.0)
        if beam is None:
            assert ends[:, k].tolist() == [0, 0, SKIPPED, 0, 0]
            continue
        hit, length = beam
        bearing = pose.theta + (scan.angle_min + k * increment)
        end = lattice.cell_of(pose.x + length * math.cos(bearing), pose.y + length * math.sin(bearing))
        assert ends[:, k].tolist() == [*end, HIT if hit else NO_RETURN, *start]


def test_metres_are_divided_into_cells():
    # 0.05 + 0.25 is 0.3, and 0.3 / 0.1 just below 3; times 1 / 0.1 it would be 3.
    scan = scan_of([0.25, 0.25], angle_min=0.0, angle_increment=math.pi / 2)
    ends = cells_of(scan, Pose(0.05, 0.05, 0.0), Lattice(0.1), GridSettings())
    assert ends[:2].tolist() == [[2, 0], [0, 2]]


def test_ranges_are_read_whatever_their_layout():
    straight = np.array([1, 2, 3, 4, 5, 6], np.float32)
    wide = np.zeros((6, 3), np.float32)
    wide[:, 1] = straight
    misaligned = np.frombuffer(b"x" + straight.tobytes(), np.float32, offset=1)
    settings, pose = GridSettings(), Pose(0.3, 0.2, 0.1)
    expected = cells_of(scan_of(straight), pose, Lattice(0.1), settings)
    for ranges in (straight[::-1].copy()[::-1], wide[:, 1], misaligned, straight.astype(">f4")):
        scan = Scan(1, -1.0, 0.3, 0.0, R_MAX, ranges)
        assert np.array_equal(cells_of(scan, pose, Lattice(0.1), settings), expected)


@pytest.mark.parametrize(
    ("scan", "pose"),
    [
        (scan_of([1.0]), Pose(1e300, 0.0, 0.0)),
        (scan_of([1.0]), Pose(0.0, -1e15, 0.0)),
        (scan_of([1.0]), Pose(INF, 0.0, 0.0)),
        (scan_of([1.0]), Pose(0.0, NAN, 0.0)),
        pytest.param(scan_of([1.0]), Pose(0.0, 0.0, INF), marks=COMPILED),
        (scan_of([1.0]), Pose(0.0, 0.0, NAN)),
        pytest.param(
            scan_of([1.0, 1.0], angle_min=1e308, angle_increment=1e308), Pose(0.0, 0.0, 0.0), marks=COMPILED
        ),
        pytest.param(scan_of([1.0], angle_min=1e308), Pose(0.0, 0.0, 1e308), marks=COMPILED),
        (scan_of([900.0], angle_min=0.0, range_max=1000.0), Pose(2**52 * 0.05 - 1, 0.0, 0.0)),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")  # NumPy's, where kernels run as plain Python
def test_what_has_no_cell_is_a_limit(scan, pose):
    with pytest.raises(LimitReached):
        cells_of(scan, pose, Lattice(0.05), GridSettings())


def test_a_skipped_beam_need_not_have_a_cell():
    scan = scan_of([1.0, NAN], angle_min=0.0, angle_increment=INF)
    ends = cells_of(scan_of([NAN], angle_min=INF), Pose(0.0, 0.0, 0.0), Lattice(0.05), GridSettings())
    assert ends.tolist() == [[0], [0], [SKIPPED], [0], [0]]
    with pytest.raises(LimitReached):  # 0 * inf
        cells_of(scan, Pose(0.0, 0.0, 0.0), Lattice(0.05), GridSettings())


def kinds_after(ends, start, rect):
    cells = np.array([(*end, *start) for end in ends], np.int64).T.copy()
    return beams.drop_outside(cells, *rect), cells[2].tolist()


def test_drop_outside_keeps_only_beams_that_end_inside():
    rect = 2, -3, 5, 4  # columns 2 to 6, rows -3 to 0
    ends = [
        (2, -3, HIT),
        (6, 0, NO_RETURN),
        (1, 0, HIT),
        (7, 0, HIT),
        (6, 1, NO_RETURN),
        (6, -4, HIT),
        (9, 9, SKIPPED),
    ]
    counts, kinds = kinds_after(ends, (4, -1), rect)
    assert counts == (6, 4)
    assert kinds == [HIT, NO_RETURN, SKIPPED, SKIPPED, SKIPPED, SKIPPED, SKIPPED]


@pytest.mark.parametrize("start", [(1, -1), (7, -1), (4, -4), (4, 1)])
def test_drop_outside_drops_every_beam_of_a_sensor_outside(start):
    counts, kinds = kinds_after([(3, -1, HIT), (4, -2, NO_RETURN), (0, 0, SKIPPED)], start, (2, -3, 5, 4))
    assert (counts, kinds) == ((2, 2), [SKIPPED] * 3)


def test_false_hits_near_range_max_fall_as_the_thickness_grows_over_the_noise():
    sigma, beam_count = 0.02, 40_000
    noise = np.random.default_rng(7).normal(0.0, sigma, beam_count)
    readings = np.clip(R_MAX + noise, 0.0, R_MAX).astype(np.float32)
    shares = []
    for ratio in (0, 1, 2, 3, 4, 6):
        settings = GridSettings(alpha=ratio * sigma)
        ends = cells_of(scan_of(readings), Pose(0.0, 0.0, 0.0), Lattice(0.1), settings)
        shares.append(np.count_nonzero(ends[2] == HIT) / beam_count)
        expected = 0.5 * math.erfc(ratio / 2 / math.sqrt(2))  # noise below -alpha / 2
        assert shares[-1] == pytest.approx(expected, abs=5 * math.sqrt(expected / beam_count))
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.49
    assert shares[-1] < 0.003


@pytest.mark.parametrize("theta", [0.0, math.pi / 2, -math.pi, 0.3, 40.0, 1e5, 1e12, 1e300])
@pytest.mark.parametrize("anchor", [(0.0, 0.0), (-3.7, 12.1), (4e5, -5e6)])
def test_turned_directions_give_the_very_cells_of_the_sum_of_angles(theta, anchor):
    # Sensors and end points on cells' edges and corners, where rounding decides which cell it is.
    rng = np.random.default_rng(7)
    settings = GridSettings(alpha=0.2, clear_range=5.0, reach=7.0)
    for resolution in (0.05, 0.25, 0.07):
        lattice = *anchor, resolution
        for increment in (math.pi / 180, -math.pi / 2, 0.01):
            ranges = (rng.integers(-2, 200, 300) * resolution).astype(np.float32)
            ranges[::40] = np.inf
            scan = scan_of(ranges, angle_min=-math.pi / 2, angle_increment=increment)
            x, y = anchor + resolution * rng.integers(-50, 50, 2)
            model, sensor = tuple(beam_model(scan, settings)), (float(x), float(y), theta)
            wanted, turned = (Beams(np.empty((5, 300), np.int64), np.empty((4, 300))) for _ in range(2))
            assert beams.project(read_only(ranges), model, np.array([sensor]), lattice, *wanted)
            bearings = directions(*model[:2], ranges.size)
            # Headings so large that rounding may move points by cells are left to `project`.
            told = beams.project_turned(read_only(ranges), model, sensor, lattice, *turned, bearings)
            assert told == (theta < 1e12)
            placed, onto = PlacedScan(scan, Pose(*sensor)), Lattice(resolution, anchor)
            found = project(placed, onto, settings, exact=True)
            assert not told or np.array_equal(turned.ends, found.ends)
            assert np.array_equal(found.ends, wanted.ends)
            counts = wanted.ends[2] != SKIPPED
            assert np.allclose(found.lines[2:, counts], wanted.lines[2:, counts], rtol=0, atol=1e-6)
            steps = (found.ends[:2] - found.ends[3:])[:, counts]
            assert (steps * found.lines[2:, counts] > 0)[steps != 0].all(), "a line leads to its end cell"
