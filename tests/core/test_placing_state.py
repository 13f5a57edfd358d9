"""Placing state: whoever goes on from it, at any message, does what an uninterrupted placer does."""

import random
import struct
from dataclasses import replace
from itertools import islice

import msgpack
import pytest

from journeys import DOUBTFUL, SAFE, Journey
from mapper_desk import MS, T0, Desk, Sink
from ogm_core.placing.rules import FORGOTTEN_AFTER, MAX_ROBOTS
from ogm_core.placing.state import CHUNK, VERSION, BadState, StateParts, outcomes_of_gone, state_of
from ogm_core.types import Pose


class BitSink(Sink):
    """Keeps every bit of what it is handed beside the scan."""

    def __init__(self):
        super().__init__()
        self.calls = []

    def integrate(self, scan, pose, sweep=None):
        along = None if sweep is None else (struct.pack("3d", *sweep.middle), sweep.beams.tobytes())
        self.calls.append((struct.pack("3d", *pose), along))
        return super().integrate(scan, pose, sweep)


class QuickDesk(Desk):
    """Looks at its books at the end only."""

    def check(self):
        """Nothing."""


class Life:
    """Lives of a mapper, one after the other; each goes on from what the one before has stored."""

    def __init__(self, parts=()):
        self.desk = QuickDesk(BitSink())
        self.stored = dict(parts)
        state, of_gone = state_of(self.stored), outcomes_of_gone(self.stored)
        self.desk.placer.restore(state, outcomes_of_gone=of_gone)
        self.writer = StateParts(self.desk.placer.state(), of_gone)

    def hand(self, n, entry):
        """Message n of all robots' journeys: a robot's name and its message."""
        desk, (robot, (kind, run, *rest)) = self.desk, entry
        if kind == "gone":
            desk.placer.robot_gone(robot, run)
            return
        seq, stamp, *rest = rest
        at = (stamp - T0) // MS
        if kind == "pose":
            desk.pose(at, Pose(*rest[0]), run=run, seq=seq, robot=robot)
        else:
            sensor, beams = rest
            desk.scan(
                *(at,),
                seq=seq,
                run=run,
                robot=robot,
                sensor=sensor,
                tag=n,
                beams=len(beams),
                time_increment=(beams[1] - beams[0]) / 1e9,
            )

    def store(self):
        """Put what has changed of the state into the parts that are stored."""
        placer = self.desk.placer
        for key, value in self.writer.changes(placer.state(), placer.outcomes_of_gone).items():
            if value is None:
                del self.stored[key]
            else:
                self.stored[key] = value
        return self.stored

    @property
    def undecided(self):
        """Numbers of the messages that wait."""
        waiting = [item.scan for robot in self.desk.placer._robots.values() for item in robot.waiting]
        return sorted(self.desk._tags[scan] for scan in waiting)

    @property
    def counted(self):
        """What became of scans, in all and of every source, in this life and those before."""
        told = self.desk.receipts.status()
        sources = {
            (name, sensor): replace(counts, hints=[], run="", last_seq=None)
            for name, robot in told.robots.items()
            for sensor, counts in robot.sources.items()
        }
        return told.scans, sources

    @property
    def placed(self):
        """Every call to the sink: which message, and where, bit for bit."""
        return list(zip(self.desk.tags, self.desk.sink.calls, strict=True))


def uninterrupted(messages):
    life = Life()
    for n, message in enumerate(messages):
        life.hand(n, message)
    return life.placed, life.counted


def interrupted(messages, cuts, looks):
    """The same of lives that end at the cuts; the state is stored at each cut, and at looks, too."""
    life, placed = Life(), []
    for n, message in enumerate(messages):
        life.hand(n, message)
        if n in looks:
            life.store()
        if n in cuts:
            parts, again = life.store(), life.undecided
            placed += life.placed
            life = Life(parts)
            for m in again:
                life.hand(m, messages[m])
    return placed + life.placed, life.counted


def check(messages, seed):
    rng = random.Random(seed)
    wanted = uninterrupted(messages)
    for count in (1, len(messages)):
        cuts = set(rng.sample(range(len(messages)), count))
        looks = set(rng.sample(range(len(messages)), 20))
        assert interrupted(messages, cuts, looks) == wanted
    return len(wanted[0])


@pytest.mark.parametrize("kind", [*SAFE, *DOUBTFUL])
def test_who_goes_on_from_a_state_does_what_who_was_not_interrupted_does(kind):
    few = 200 if kind == "one stamp" else None  # of which nearly all wait
    for seed in range(2):
        check([("r", message) for message in Journey(kind, seed).messages[:few]], seed)


def test_many_robots_go_on_from_their_states():
    rng, kinds = random.Random(1), [*SAFE, *DOUBTFUL]
    for seed in range(2):
        journeys = {f"r{n}": iter(Journey(rng.choice(kinds), seed).messages) for n in range(4)}
        messages = []
        while journeys:
            name = rng.choice(list(journeys))
            messages += [(name, message) for message in islice(journeys[name], rng.randrange(1, 9))] or [None]
            if messages[-1] is None:
                messages.pop()
                del journeys[name]
        assert check(messages, seed) > 100


def put(parts, changes):
    """Parts after some changes."""
    return {key: value for key, value in {**parts, **changes}.items() if value is not None}


def drive(desk, robot, count, begin=0, **fields):
    """Poses at 10 Hz."""
    for k in range(begin, begin + count):
        desk.pose(100 * k, run="a", seq=k, robot=robot, **fields)


def test_only_parts_that_have_changed_are_told():
    desk, writer = Desk(), StateParts()
    drive(desk, "r", 2 * CHUNK + 10)
    drive(desk, "q", 5)
    first = desk.placer.state()
    parts = put({}, writer.changes(first))
    assert set(parts) == {"r", "r/0", "r/1", "r/2", "q", "q/0"}
    assert writer.changes(desk.placer.state()) == {}
    drive(desk, "r", 1, begin=2 * CHUNK + 10)
    second = desk.placer.state()
    assert second["q"] is first["q"]
    changes = writer.changes(second)
    assert set(changes) == {"r", "r/2"}
    assert len(changes["r/2"]) == 8 + 33 * 11
    drive(desk, "r", CHUNK, begin=2 * CHUNK + 11)
    changes = writer.changes(desk.placer.state())
    assert set(changes) == {"r", "r/2", "r/3"}
    desk.placer.robot_gone("q", "a")
    assert set(changes := writer.changes(desk.placer.state())) == {"q", "q/0"}
    desk.pose(0, run="b", seq=0, robot="r")  # a new history
    changes = writer.changes(desk.placer.state())
    assert {key for key, value in changes.items() if value is None} == {"r/1", "r/2", "r/3"}
    assert {key for key, value in changes.items() if value is not None} == {"r", "r/0"}


def test_what_is_told_is_whole_however_it_came_together():
    """Chunks that were put long ago, of which the first poses are forgotten by now, too."""
    desk, writer, parts = Desk(fewest_poses=300, most_poses=600), StateParts(), {}
    for k in range(40):
        drive(desk, "r", 37, begin=37 * k)
        if k == 20:
            desk.pose(100 * 37 * 21 - 100, Pose(9, 9, 9), run="a", seq=37 * 21, robot="r")  # ambiguous
        parts = put(parts, writer.changes(desk.placer.state()))
        if k == 25:  # another life
            before = desk
            desk = Desk(fewest_poses=300, most_poses=600)
            desk.placer.restore(state_of(parts))
            writer = StateParts(desk.placer.state())
            assert before.placer.robots_bytes * 0.7 < desk.placer.robots_bytes <= before.placer.robots_bytes
        (got,) = state_of(parts).values()
        wanted = desk.placer.state()["r"].history
        assert (got.history.first, got.history.end) == (wanted.first, wanted.end)
        for name in ("stamps", "poses", "ambiguous"):
            assert bytes(getattr(got.history, name)) == bytes(getattr(wanted, name))
    assert wanted.first > CHUNK
    assert len(parts) == 1 + len({n // CHUNK for n in range(wanted.first, wanted.end)})


def test_a_robot_that_is_forgotten_leaves_nothing():
    desk, writer = Desk(), StateParts()
    drive(desk, "r", CHUNK + 1)
    drive(desk, "q", 1)
    parts = put({}, writer.changes(desk.placer.state()))
    desk.now = FORGOTTEN_AFTER
    drive(desk, "q", 1, begin=1)
    desk.placer.expire(FORGOTTEN_AFTER + 1)
    changes = writer.changes(desk.placer.state())
    assert {key for key, value in changes.items() if value is None} == {"r", "r/0", "r/1"}
    assert set(state_of(put(parts, changes))) == {"q"}


def test_what_is_told_does_not_change_any_more():
    desk = Desk()
    drive(desk, "r", 20)
    for seq in range(0, 20, 2):
        desk.scan(100 * seq, run="a", seq=seq).scan(100 * seq, run="a", seq=seq, sensor="t")
    state = desk.placer.state()
    then = StateParts().changes(state)
    drive(desk, "r", 3000, begin=20)
    desk.pose(100 * 3019, Pose(9, 9, 9), run="a", seq=3020)
    for seq in range(1, 60):
        desk.scan(100 * seq, run="a", seq=seq)
    assert StateParts().changes(state) == then
    assert StateParts().changes(desk.placer.state()) != then


def damaged(parts):
    """Parts of which something is missing or wrong, and what is said of it."""
    head, chunk = parts["r"], parts["r/1"]
    yield {**parts, "r/1": None}, "parts of it are missing"
    yield {**parts, "r/1": chunk[:-1]}, "not all there"
    yield {**parts, "r/1": chunk[: 8 + 33 * 3]}, "not all there"
    yield {**parts, "r/1": parts["r/0"]}, "not all there"
    yield {**parts, "r/0": parts["r/1"]}, "not all there"
    yield {**parts, "r": b"\xc1"}, "damaged"
    yield {**parts, "r": head[:-20]}, "damaged"
    yield {**parts, "r": msgpack.packb({})}, "damaged"
    yield {**parts, "r": msgpack.packb([VERSION, [0, 1, 0, 0], {}])}, "damaged"
    newer = msgpack.packb([VERSION + 1, [0, 0, 0, 0], {}])
    yield {**parts, "r": newer}, f"version {VERSION + 1}, and this program knows {VERSION}"


def test_what_is_damaged_is_refused_and_named():
    desk = Desk()
    drive(desk, "q", 2)
    drive(desk, "r", 2 * CHUNK)
    for parts, said in damaged(StateParts().changes(desk.placer.state())):
        with pytest.raises(BadState, match=f"^placing state of robot r: .*{said}"):
            state_of(put(parts, {}))


def test_a_robot_is_known_for_an_hour_after_a_restart():
    desk = Desk()
    drive(desk, "r", 3)
    state = state_of(StateParts().changes(desk.placer.state()))
    later = Desk()
    later.placer.restore(state, now=10.0)
    robot = later.receipts.status(11.0).robots["r"]
    assert (robot.alive, robot.age_s, robot.pose) == (False, None, None)
    later.placer.expire(10.0 + FORGOTTEN_AFTER)
    later.scan(150, run="a", seq=0)
    assert later.order == [0]
    alone = Desk()
    alone.placer.restore(state, now=10.0)
    alone.placer.expire(11.0 + FORGOTTEN_AFTER)
    assert alone.placer.state() == {}


def test_robots_that_are_too_many_are_left_out():
    desk = Desk()
    drive(desk, "r", 1)
    (told,) = desk.placer.state().values()
    many = Desk()
    many.placer.restore({f"r{n}": told for n in range(MAX_ROBOTS + 5)})
    assert len(many.placer.state()) == MAX_ROBOTS


def waiting():
    """A desk of another life, that expects three scans of sensor s, and one of t; poses are at 0, 0.1 s."""
    desk = Desk()
    drive(desk, "r", 2)
    for seq, at in ((0, 110), (1, 120), (2, 130)):
        desk.scan(at, run="a", seq=seq, tag=seq)
    desk.scan(115, run="a", seq=0, sensor="t", tag="t")
    again = Desk()
    again.placer.restore(state_of(StateParts().changes(desk.placer.state())))
    return again


def test_scans_that_waited_take_their_place_again_in_whichever_order_they_come():
    desk = waiting()
    desk.scan(115, run="a", seq=0, sensor="t", tag="t")
    for seq, at in ((2, 130), (0, 110), (1, 120)):  # no step back of their clock
        desk.scan(at, run="a", seq=seq, tag=seq)
    desk.pose(200, run="a", seq=2)
    assert (desk.tags, desk.dropped) == ([0, 1, 2, "t"], {})


def test_scans_that_waited_are_seen_again_once():
    desk = waiting()
    for _ in range(2):
        desk.scan(110, run="a", seq=0, tag=0)
    desk.scan(125, run="a", seq=1)  # another scan under its number
    desk.pose(200, run="a", seq=2)
    assert (desk.tags, desk.dropped) == ([0], {"duplicate": 2})


@pytest.mark.parametrize(
    "end",
    [
        lambda desk: desk.pose(120, run="b", seq=0),
        lambda desk: desk.pose(20, run="a", seq=2),
        lambda desk: desk.scan(40, run="a", seq=3),
    ],
    ids=["another publisher", "a step back of the poses", "a step back of the scans"],
)
def test_what_ends_the_wait_of_those_that_wait_ends_that_of_those_that_are_expected(end):
    desk = waiting()
    end(desk)
    for seq, at in ((0, 110), (1, 120), (2, 130)):
        desk.scan(at, run="a", seq=seq, tag=seq)
    assert desk.dropped == {"duplicate": 3}


def test_where_a_pose_has_come_first_a_scan_that_waited_is_placed_at_once():
    desk = waiting()
    desk.pose(200, run="a", seq=2)
    desk.scan(120, run="a", seq=1, tag=1).scan(110, run="a", seq=0, tag=0)
    assert (desk.tags, desk.xs) == ([1, 0], [pytest.approx(0.12), pytest.approx(0.11)])


def test_the_first_scan_of_another_run_waits_for_a_pose_in_another_life_too():
    desk, again = Desk(), Desk()
    drive(desk, "r", 3)
    desk.scan(50, run="a", seq=0)
    again.placer.restore(state_of(StateParts().changes(desk.placer.state())))
    for each in (desk, again):
        placed = len(each.order)
        each.scan(150, run="b", seq=7)
        assert each.order[placed:] == []
        each.pose(300, run="a", seq=3)
        assert each.order[placed:] == [7]


def test_what_was_counted_is_stored_with_what_is_decided():
    """Scans in the map, dropped before they were read, lost, and of a robot that is forgotten by then."""
    life = Life()
    desk, decided = life.desk, life.desk.placer.decided
    drive(desk, "q", 2)
    desk.scan(50, run="a", seq=0, robot="q").scan(50, run="a", seq=0, robot="q")
    drive(desk, "r", 2)
    desk.scan(50, run="a", seq=0)
    decided.skip("r", "s", "a", 1, 3, "overload")
    decided.skip("r", "s", "a", 4, 9, "lost", count=5)  # one of them was decided before
    decided.drop_unnumbered("r", "s", "malformed")
    decided.skip("r", None, "a", 5, 9)
    desk.scan(500, run="a", seq=10)  # which waits, and is counted when it comes again
    desk.now = FORGOTTEN_AFTER + 1
    desk.pose(200, run="a", seq=2)
    desk.placer.expire(desk.now)
    again = Life(life.store())
    scans, _ = again.counted
    assert (scans.received, scans.integrated, scans.pending, scans.lost) == (7, 2, 0, 5)
    dropped = {"overload": 3, "malformed": 1}
    assert {reason: count for reason, count in scans.dropped.items() if count} == dropped | {"duplicate": 1}
    of_r = again.desk.receipts.status().robots["r"].sources["s"]
    assert (of_r.run, of_r.last_seq) == ("a", 10)
    assert (of_r.received, of_r.integrated, of_r.dropped, of_r.lost) == (5, 1, dropped, 5)
    again.hand(0, ("r", ("scan", "a", 10, T0 + 500 * MS, "s", [0, 0])))
    now = again.desk.receipts.status(since_start=True)
    assert (now.scans.received, now.scans.pending, now.scans.integrated, now.scans.lost) == (1, 1, 0, 0)
    assert now.robots["r"].sources["s"].received == 1
    assert now.robots["r"].sources["s"].dropped == {}
    assert again.counted[0].received == 8
    third = Life(again.store())
    assert third.counted[0] == scans


def test_counts_that_an_older_program_has_not_stored_begin_anew():
    desk = Desk()
    drive(desk, "r", 2)
    desk.scan(50, run="a", seq=0)
    (told,) = desk.placer.state().values()
    head = dict(told.head)
    for name in ("outcomes", "last"):
        del head["sources"]["s"][name]
    again = Desk()
    again.placer.restore({"r": replace(told, head=head)})
    status = again.receipts.status()
    assert (status.scans.received, status.robots["r"].sources) == (0, {})
    again.scan(50, run="a", seq=0)
    assert again.dropped == {"duplicate": 1}


def test_damaged_counts_of_robots_that_are_gone_are_refused():
    with pytest.raises(BadState, match="counted of robots that were forgotten is damaged"):
        outcomes_of_gone({"/gone": b"\x01"})
