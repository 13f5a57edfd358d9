"""Hold and ask, on real sessions: what was missed comes out of caches, in order and once, before the rest."""

import math
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import pytest
import zenoh
from zenoh import ext

from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_core.wire.heads import read_head
from ogm_core.wire.keys import MapKeys, Source
from ogm_core.wire.messages import encode_pose, encode_scan
from ogm_services.mapper.intake import caches as caches_module
from ogm_services.mapper.intake import catching_up, robot_caches
from ogm_services.mapper.intake import held as held_module
from ogm_services.mapper.intake import hold_and_ask as hold_module
from ogm_services.mapper.intake.caches import Answer, Caches
from ogm_services.mapper.intake.held_source import SILENCE
from ogm_services.mapper.intake.hold_and_ask import HoldAndAsk

KEYS = MapKeys("hall")
POSES, SCANS = Source("r", None), Source("r", "s")
NUMBERED = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None)


@dataclass
class Recorder:
    """What is handed on, lost and replayed; what was decided in an earlier life; whether there is room."""

    handed_on: list = field(default_factory=list)
    """("pose" or sensor, run, seq), or the payload of what has no number."""
    gone: list = field(default_factory=list)
    came_again: list = field(default_factory=list)
    decided: set = field(default_factory=set)
    """(sensor or None, run, seq)."""
    up_to: dict = field(default_factory=dict)
    """By (sensor or None, run)."""
    why_gone: list = field(default_factory=list)
    skipped: list = field(default_factory=list)
    waits: list = field(default_factory=list)
    room: bool = True

    def hand_on(self, source, payload, *, resumed=False):
        head = read_head(payload)
        self.handed_on.append(payload if head is None else (source.sensor or "pose", head[2], head[1]))

    def admits(self, robot):
        return robot != "refused"

    def has_room(self, robot, part):
        return self.room

    def lost(self, source, count, run, seqs, why):
        self.why_gone.append(why)
        self.gone.append((source.sensor, run, count, list(seqs)))

    def replayed(self, source):
        self.came_again.append(source.sensor)

    def is_decided(self, robot, sensor, run, seq):
        return (sensor, run, seq) in self.decided

    def last(self, robot, sensor, run):
        return self.up_to.get((sensor, run))

    def drop_unnumbered(self, robot, sensor, outcome):
        pass

    def skip(self, robot, sensor, run, first, last, outcome="lost", count=None):
        self.skipped.append((sensor, run, first, last))

    def wait_on(self, robot, until):
        self.waits.append(until)

    def seqs(self, key="s", run="a"):
        return [item[2] for item in self.handed_on if item[:2] == (key, run)]


@pytest.fixture
def recorder():
    return Recorder()


@pytest.fixture
def hold(listener, recorder):
    """Holds and asks on `listener`; what comes is put in by the test, with `take`."""
    hold = HoldAndAsk(Caches(listener, KEYS, lambda _: 1000), recorder, recorder)
    yield hold
    hold.stop()


@pytest.fixture
def started(hold):
    """The same, that hears of caches and looks."""
    hold.start()
    return hold


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Pauses are short, and nobody waits for caches that do not answer but three times."""
    monkeypatch.setattr(catching_up, "PAUSES", (0.02, 0.02))
    monkeypatch.setattr(robot_caches, "SILENT", 0.0)


@pytest.fixture
def robot_session(listener, endpoint):
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        yield session


@pytest.fixture
def cache(robot_session, listener, eventually):
    """`cache(source, samples=...)` is a publisher with a cache, of one that numbers its samples."""

    def make(source=SCANS, samples=1000, **options):
        key = KEYS.pose("r") if source.sensor is None else KEYS.scan("r", source.sensor)
        config = ext.CacheConfig(max_samples=samples)
        options = {"sample_miss_detection": NUMBERED, "publisher_detection": True, **options}
        publisher = ext.declare_advanced_publisher(robot_session, key, cache=config, **options)
        eventually(lambda: is_known(listener, source))
        return publisher

    return make


def is_known(listener, source=SCANS):
    """Whether the token of a cache is there, which can be asked then: its declaration takes a moment."""
    key = KEYS.pose("r") if source.sensor is None else KEYS.scan("r", source.sensor)
    return any(listener.liveliness().get(f"{key}/@adv/**", timeout=30.0))


@pytest.fixture
def asked(listener, monkeypatch):
    """The parameters of every question that was asked."""
    questions, ask = [], Caches.ask

    def noting(self, robot, keys, parameters, account):
        questions.append(parameters)
        return ask(self, robot, keys, parameters, account)

    monkeypatch.setattr(Caches, "ask", noting)
    return questions


def scan(seq, run="a", stamp=None):
    ranges = np.ones(3, np.float32)
    return encode_scan(Scan(seq if stamp is None else stamp, 0.0, 0.1, 0.1, 30.0, ranges, seq=seq, run=run))


def pose(seq, run="a", stamp=None):
    return encode_pose(PoseStamped(seq if stamp is None else stamp, Pose(0.0, 0.0, 0.0), seq, run))


def take(hold, *payloads, source=SCANS):
    for payload in payloads:
        hold.take(source, payload, time.monotonic())


def test_messages_that_follow_one_another_are_handed_on_at_once_and_nobody_is_asked(hold, recorder, asked):
    take(hold, *(scan(seq) for seq in range(5)), *(scan(9, run="") for _ in range(3)))
    take(hold, *(pose(seq) for seq in range(3)), source=POSES)
    assert recorder.seqs() == [0, 1, 2, 3, 4]
    assert recorder.seqs("pose") == [0, 1, 2]
    assert recorder.seqs(run="") == [9, 9, 9]
    assert (asked, recorder.gone, hold.held) == ([], [], 0)


def test_what_is_missing_comes_out_of_the_cache_before_what_came_later(hold, recorder, cache, eventually):
    publisher = cache()
    for seq in range(10):
        publisher.put(scan(seq))
    take(hold, scan(0), scan(1), scan(5), scan(6))
    eventually(lambda: len(recorder.handed_on) == 10)
    assert recorder.seqs() == list(range(10))
    take(hold, *(scan(seq) for seq in (7, 8, 9, 10)))
    eventually(lambda: len(recorder.handed_on) == 11)
    assert recorder.seqs() == list(range(11))
    eventually(lambda: hold.held == 0)
    # 5 was held, 7 to 9 came after: they came twice; 6 was held if it came before the answer.
    assert len(recorder.came_again) in (3, 4)
    assert recorder.gone == []


def test_a_long_backlog_comes_in_parts(hold, recorder, cache, asked, eventually, monkeypatch):
    monkeypatch.setattr("ogm_services.mapper.intake.backlog.PART", 20)
    recorder.up_to[SCANS.sensor, "a"] = 99
    publisher = cache()
    for seq in range(200):
        publisher.put(scan(seq))
    take(hold, scan(199))
    eventually(lambda: len(recorder.handed_on) == 100)
    assert recorder.seqs() == list(range(100, 200))
    parts = [question for question in asked if ".." in question and "_max" not in question]
    assert parts == ["_sn=100..120", "_sn=121..141", "_sn=142..162", "_sn=163..183"]
    assert recorder.gone == []


@pytest.mark.parametrize("numbered", [True, False])
def test_a_run_that_nobody_knows_is_taken_from_the_first_that_is_kept(
    endpoint, listener, recorder, hold, eventually, numbered
):
    """A cache of 300, of which 500 messages were sent: one that numbers its samples and one that does not."""
    config = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}, timestamping: {{enabled: true}}}}'
    )
    with zenoh.open(config) as session:
        options = {"publisher_detection": True, **({"sample_miss_detection": NUMBERED} if numbered else {})}
        publisher = ext.declare_advanced_publisher(
            session, KEYS.scan("r", "s"), cache=ext.CacheConfig(max_samples=300), **options
        )
        eventually(lambda: is_known(listener))
        for seq in range(500):
            publisher.put(scan(seq))
        take(hold, scan(500))
        eventually(lambda: len(recorder.handed_on) == 301)
        assert recorder.seqs() == list(range(200, 501))
        assert recorder.gone == []


def test_poses_and_scans_are_merged_by_stamp_a_pose_first_each_key_in_its_order(
    hold, recorder, cache, eventually
):
    poses, scans, others = cache(POSES), cache(SCANS), cache(Source("r", "t"))
    for seq, stamp in enumerate([10, 20, 30, 30, 5, 40]):  # the clock goes back once
        poses.put(pose(seq, stamp=stamp))
    for seq, stamp in enumerate([10, 15, 30, 41]):
        scans.put(scan(seq, stamp=stamp))
    others.put(scan(0, stamp=15))
    take(hold, scan(4, stamp=50))
    eventually(lambda: len(recorder.handed_on) == 12)
    order = [(key, seq) for key, _, seq in recorder.handed_on]
    assert order[:2] == [("pose", 0), ("s", 0)]
    assert sorted(order[2:4]) == [("s", 1), ("t", 0)]
    assert order[4:] == [
        *(("pose", 1), ("pose", 2), ("pose", 3), ("pose", 4)),  # the last one before what its stamp says
        *(("s", 2), ("pose", 5), ("s", 3), ("s", 4)),
    ]


def test_what_is_held_keeps_its_order_though_one_cache_answers_before_another_is_there(
    hold, recorder, cache, eventually, monkeypatch
):
    """A pose's cache is asked when scans have none yet: no pose goes before the scans that came before it."""
    poses, ask = cache(POSES), Caches.ask

    def meanwhile(self, robot, keys, parameters, account):
        if len(recorder.handed_on) == 2 and not poses_kept:
            for seq in range(1, 6):
                poses_kept.append(pose(seq))
                poses.put(poses_kept[-1])
                take(hold, poses_kept[-1], source=POSES)
                take(hold, scan(seq))
        return ask(self, robot, keys, parameters, account)

    poses_kept = []
    monkeypatch.setattr(Caches, "ask", meanwhile)
    poses.put(pose(0))
    take(hold, pose(0), source=POSES)
    take(hold, scan(0))
    hold.ask_all()
    eventually(lambda: len(recorder.handed_on) == 12)
    assert [(key, seq) for key, _, seq in recorder.handed_on] == [
        (key, seq) for seq in range(6) for key in ("pose", "s")
    ]
    assert (recorder.gone, recorder.came_again) == ([], [])


def test_scans_of_a_cache_go_between_the_poses_that_are_held_by_their_stamps(
    hold, recorder, cache, eventually
):
    """Scans were lost on a full link, which their poses passed: no scan goes far ahead of its pose."""
    scans = cache(SCANS)
    for seq in range(7):
        scans.put(scan(seq))
    take(hold, pose(0), source=POSES)
    take(hold, scan(0))
    recorder.room = False
    take(hold, scan(2))  # 1 is missing: the robot is held
    eventually(lambda: hold._robots["r"].is_held)
    take(hold, *(pose(seq) for seq in range(1, 6)), source=POSES)
    take(hold, scan(6))
    recorder.room = True
    eventually(lambda: len(recorder.handed_on) == 13)
    order = [(key, seq) for key, _, seq in recorder.handed_on]
    # 2 is held before the poses, so it goes before them; 3 to 5 come out of the cache.
    assert order[:4] == [("pose", 0), ("s", 0), ("s", 1), ("s", 2)]
    pairs = [(key, seq) for seq in (3, 4, 5) for key in ("pose", "s")]
    assert order[4:] == [("pose", 1), ("pose", 2), *pairs, ("s", 6)]
    assert (recorder.gone, recorder.came_again) == ([], [])


def test_what_was_decided_in_an_earlier_life_is_replayed(hold, recorder, cache, eventually):
    recorder.up_to["s", "a"] = 3
    recorder.decided |= {("s", "a", seq) for seq in (0, 1, 2, 3, 5, 6)}
    publisher = cache()
    for seq in range(9):
        publisher.put(scan(seq))
    take(hold, scan(9))
    eventually(lambda: len(recorder.handed_on) == 4)
    assert recorder.seqs() == [4, 7, 8, 9]
    assert recorder.came_again == ["s", "s"]
    assert recorder.gone == []


def robots_of(count):
    return [Source(f"r{k}", "s") for k in range(count)]


def test_all_robots_are_held_at_once_however_many_there_are(hold, recorder, eventually, monkeypatch):
    """More than are asked at a time."""
    for source in robots_of(40):
        take(hold, scan(0), source=source)
    answered, ask = threading.Event(), Caches.ask
    monkeypatch.setattr(Caches, "ask", lambda *question: (answered.wait(30.0), ask(*question))[1])
    hold.ask_all()
    for source in robots_of(40):
        take(hold, scan(1), source=source)
    assert recorder.seqs() == 40 * [0]
    answered.set()
    eventually(lambda: recorder.seqs() == 40 * [0] + 40 * [1])


def test_what_comes_after_a_standstill_is_held_before_anybody_has_looked(hold, recorder, eventually):
    take(hold, scan(0))
    recorder.room = False
    hold._looked = time.monotonic() - 2.0 * hold_module.FROZEN
    take(hold, scan(1), scan(2))
    assert recorder.seqs() == [0]
    hold._looked = time.monotonic()
    recorder.room = True
    eventually(lambda: recorder.seqs() == [0, 1, 2])
    eventually(lambda: hold.held == 0)


def test_scans_are_not_taken_before_poses_that_a_cache_must_have(
    hold, recorder, cache, asked, eventually, monkeypatch
):
    """The cache of the poses comes later: that of its run some were decided tells that there are more."""
    monkeypatch.setattr(catching_up, "PAUSES", (0.5, 5.0))
    recorder.up_to |= {(None, "a"): 1, ("s", "a"): 1}
    scans = cache()
    for seq in (2, 3):
        scans.put(scan(seq, stamp=10 * seq))
    take(hold, scan(4, stamp=40))
    eventually(lambda: asked)
    assert recorder.handed_on == []
    poses = cache(POSES)
    for seq in (2, 3):
        poses.put(pose(seq, stamp=10 * seq))
    eventually(lambda: len(recorder.handed_on) == 5)
    order = [(key, seq) for key, _, seq in recorder.handed_on]
    assert order == [("pose", 2), ("s", 2), ("pose", 3), ("s", 3), ("s", 4)]


def test_caches_of_a_robot_that_come_one_by_one_are_asked_together(
    hold, recorder, cache, eventually, monkeypatch
):
    monkeypatch.setattr(hold_module, "SETTLING", 0.5)
    scans = cache()
    for seq in range(3):
        scans.put(scan(seq, stamp=10 * seq))
    hold.cache_changed(SCANS, "one", True)
    poses = cache(POSES)
    for seq in range(3):
        poses.put(pose(seq, stamp=10 * seq))
    hold.cache_changed(POSES, "other", True)
    eventually(lambda: len(recorder.handed_on) == 6)
    assert [key for key, _, _ in recorder.handed_on] == ["pose", "s"] * 3


def test_scans_wait_for_their_poses_while_their_robot_is_held_and_when_its_cache_is_gone(
    hold, recorder, eventually
):
    take(hold, scan(0))
    assert recorder.waits == []
    hold.ask_all()
    eventually(lambda: len(recorder.waits) == 2)
    held, released = recorder.waits
    assert held == math.inf
    assert released <= time.monotonic()
    hold.cache_changed(SCANS, "one", False)
    assert recorder.waits[2] > time.monotonic() + robot_caches.AWAY / 2.0


def test_what_is_missing_of_a_robot_whose_caches_have_just_gone_is_not_lost(
    hold, recorder, cache, asked, eventually
):
    """As when a router ends: what comes by itself is back before its publisher's cache is."""
    hold.cache_changed(SCANS, "one", True)
    eventually(lambda: asked)
    take(hold, scan(0))
    eventually(lambda: recorder.seqs() == [0])
    hold.cache_changed(SCANS, "one", False)
    take(hold, scan(4))
    eventually(lambda: len(asked) > 5 * catching_up.ASKS)
    assert recorder.gone == []
    publisher = cache()
    for seq in range(5):
        publisher.put(scan(seq))
    eventually(lambda: recorder.seqs() == list(range(5)))
    assert recorder.gone == []


def test_what_is_missing_of_a_robot_whose_caches_are_gone_for_long_is_lost(
    hold, recorder, eventually, monkeypatch
):
    monkeypatch.setattr(robot_caches, "AWAY", 0.0)
    hold.cache_changed(SCANS, "one", True)
    take(hold, scan(0))
    hold.cache_changed(SCANS, "one", False)
    take(hold, scan(4))
    eventually(lambda: recorder.seqs() == [0, 4])
    assert recorder.gone == [("s", "a", 3, [1, 2, 3])]


def test_a_gap_that_no_cache_fills_is_asked_for_three_times_and_lost(
    hold, recorder, listener, robot_session, asked, eventually
):
    questions = []

    def nothing(query):
        with query:
            questions.append(str(query.selector))

    handler = zenoh.handlers.Callback(nothing, indirect=False)
    robot_session.declare_queryable(f"{KEYS.scan('r', 's')}/@adv/pub/x/1/_", handler)
    token = robot_session.liveliness().declare_token(f"{KEYS.scan('r', 's')}/@adv/pub/x/1/_")
    eventually(lambda: is_known(listener))
    take(hold, scan(0), scan(1), scan(5), scan(7))
    take(hold, pose(0), source=POSES)
    eventually(lambda: recorder.seqs("pose"))
    assert recorder.seqs() == [0, 1, 5, 7]
    assert recorder.gone == [("s", "a", 3, [2, 3, 4]), ("s", "a", 1, [6])]
    assert recorder.skipped == [("s", "a", 2, 4), ("s", "a", 6, 6)]
    assert len(asked) == 3
    assert len(questions) == 3
    token.undeclare()
    take(hold, scan(9))  # there is no cache, as is known by now
    assert recorder.seqs() == [0, 1, 5, 7, 9]
    assert recorder.gone[2:] == [("s", "a", 1, [8])]
    assert recorder.why_gone == ["not kept"] * 3
    assert len(asked) == 3


def test_a_new_run_is_asked_for_again_where_no_cache_was(hold, recorder, cache, eventually):
    take(hold, scan(0), scan(2))
    eventually(lambda: recorder.gone)
    publisher = cache()
    for seq in range(3):
        publisher.put(scan(seq, run="b"))
    take(hold, scan(3, run="b"))
    eventually(lambda: len(recorder.seqs(run="b")) == 4)
    assert recorder.seqs(run="b") == [0, 1, 2, 3]


def test_what_a_cache_keeps_no_more_is_lost_and_the_rest_is_taken(hold, recorder, cache, eventually):
    publisher = cache(samples=40)
    for seq in range(100):
        publisher.put(scan(seq))
    take(hold, scan(0), scan(99))
    eventually(lambda: len(recorder.handed_on) == 41)
    assert recorder.seqs() == [0, *range(60, 100)]
    assert recorder.gone == [("s", "a", 59, list(range(1, 60)))]


def test_what_a_cache_keeps_no_more_is_lost_also_if_nothing_comes_by_itself(
    hold, recorder, cache, asked, eventually
):
    """A robot that is silent since the mapper is back: nothing that is held shows the gap."""
    recorder.up_to["s", "a"] = 4
    publisher = cache(samples=40)
    for seq in range(100):
        publisher.put(scan(seq))
    hold.start()
    eventually(lambda: len(recorder.handed_on) == 40)
    assert recorder.seqs() == list(range(60, 100))
    assert recorder.gone == [("s", "a", 55, list(range(5, 60)))]
    assert asked.count("_max=16") == 1  # that nothing older is kept is certain: no more questions are needed


def test_a_cache_that_answers_at_the_third_question_loses_nothing_though_nothing_comes_by_itself(
    hold, recorder, cache, eventually, monkeypatch
):
    publisher, ask, failing = cache(), Caches.ask, [2]
    for seq in range(5):
        publisher.put(scan(seq))

    def failing_twice(self, robot, keys, parameters, account):
        if failing[0]:
            failing[0] -= 1
            return caches_module.Answer(whole=False)
        return ask(self, robot, keys, parameters, account)

    monkeypatch.setattr(Caches, "ask", failing_twice)
    hold.start()
    eventually(lambda: len(recorder.handed_on) == 5)
    assert recorder.seqs() == [0, 1, 2, 3, 4]
    assert recorder.gone == []


def test_seqs_that_a_publisher_left_out_are_lost_at_once(hold, recorder, cache, asked, eventually):
    publisher = cache()
    for seq in range(0, 12, 3):
        publisher.put(scan(seq))
    take(hold, scan(0), scan(9))
    eventually(lambda: len(recorder.handed_on) == 4)
    assert recorder.seqs() == [0, 3, 6, 9]
    assert [count for _, _, count, _ in recorder.gone] == [2, 2, 2]
    assert asked == ["_max=16"]


def test_a_cache_that_appears_is_asked(started, recorder, cache, eventually):
    publisher = cache(POSES)
    for seq in range(3):
        publisher.put(pose(seq))
    eventually(lambda: len(recorder.handed_on) >= 1)  # it may have been asked before the first one
    started.ask_all()
    eventually(lambda: len(recorder.handed_on) == 3)
    assert recorder.seqs("pose") == [0, 1, 2]


def test_caches_that_were_there_before_are_asked(hold, recorder, endpoint, listener, eventually):
    """A robot that publishes no more, as one that stopped while the mapper was away."""
    sweep = {"angle_min": 0.0, "angle_increment": 0.1, "range_min": 0.1, "range_max": 30.0}
    with RobotPublisher("r", address=endpoint, map_name="hall", run="a") as robot:
        for stamp in range(40):
            robot.publish_pose(0.0, 0.0, 0.0, stamp=stamp)
            robot.publish_scan([1.0], sensor="s", stamp=stamp, **sweep)
        hold.start()
        eventually(lambda: len(recorder.handed_on) == 80)
    assert recorder.handed_on == [(key, "a", seq) for seq in range(40) for key in ("pose", "s")]


def test_a_source_that_is_silent_is_asked(started, recorder, cache, asked, eventually):
    publisher = cache()
    eventually(lambda: asked and not started.held and not any(r.at_work for r in started._robots.values()))
    publisher.put(scan(0))
    publisher.put(scan(1))
    take(started, scan(0))  # the last one was missed
    now = time.monotonic()
    started.look(now + SILENCE - 1.0)
    assert recorder.seqs() == [0]
    started.look(now + SILENCE + 1.0)
    eventually(lambda: recorder.seqs() == [0, 1])
    before = len(asked)
    started.look(now + SILENCE + 2.0)  # it has just been asked
    started.look(now + 2.0 * SILENCE + 3.0)
    assert len(asked) == before
    publisher.put(scan(2))
    started.look(now + 4.0 * SILENCE)
    eventually(lambda: recorder.seqs() == [0, 1, 2])


def test_a_message_that_nobody_can_read_is_not_asked_for(hold, recorder, cache, asked, eventually):
    publisher = cache()
    for payload in (scan(0), b"bad", scan(2)):
        publisher.put(payload)
    take(hold, scan(0), b"bad", scan(2))
    assert recorder.handed_on == [("s", "a", 0), b"bad", ("s", "a", 2)]
    hold.unread(SCANS)  # one that was too long
    take(hold, scan(4))
    assert asked == []
    publisher.put(b"too long" * 200)
    publisher.put(scan(4))
    publisher.put(scan(5))
    take(hold, scan(6))
    eventually(lambda: recorder.seqs() == [0, 2, 4, 5, 6])
    assert recorder.gone == []


def test_far_seqs_are_handed_on_and_nobody_is_asked(hold, recorder, asked):
    take(hold, scan(0), scan(3_000_000), scan(1), scan(4_000_000))
    assert recorder.seqs() == [0, 3_000_000, 1, 4_000_000]
    assert asked == []


def test_a_number_that_comes_again_by_itself_is_handed_on_for_the_placer_to_drop(hold, recorder):
    take(hold, scan(0), scan(1), scan(1), scan(0, stamp=7))
    assert recorder.seqs() == [0, 1, 1, 0]
    assert recorder.came_again == []


def test_what_waits_in_the_queue_is_only_so_much_of_a_backlog(hold, recorder, cache, eventually):
    publisher = cache()
    for seq in range(8):
        publisher.put(scan(seq))
    recorder.room = False
    take(hold, scan(0), scan(7), scan(8))
    time.sleep(0.2)
    assert recorder.seqs() == [0]
    recorder.room = True
    eventually(lambda: recorder.seqs() == list(range(9)))


def test_what_is_held_is_bounded_and_what_goes_comes_out_of_the_cache(
    hold, recorder, cache, eventually, monkeypatch
):
    monkeypatch.setattr(held_module, "MAX_BYTES", 40_000)
    publisher = cache()
    for seq in range(300):
        publisher.put(scan(seq))
    recorder.room = False
    take(hold, scan(0), *(scan(seq) for seq in range(100, 300)))
    assert hold._bytes.all <= 10_000
    recorder.room = True
    eventually(lambda: recorder.seqs() == list(range(300)))
    eventually(lambda: hold.held == 0)
    assert recorder.gone == []


def test_other_robots_are_not_held(hold, recorder, cache):
    publisher = cache()
    publisher.put(scan(0))
    recorder.room = False
    take(hold, scan(1))
    take(hold, scan(0, run="b"), scan(1, run="b"), source=Source("other", "s"))
    assert recorder.seqs(run="b") == [0, 1]


def test_a_cache_that_does_not_answer_holds_its_robot_for_three_questions(
    hold, recorder, listener, robot_session, eventually, monkeypatch
):
    monkeypatch.setattr(caches_module, "TIMEOUT", 0.2)
    kept = []
    handler = zenoh.handlers.Callback(kept.append, indirect=False)
    robot_session.declare_queryable(f"{KEYS.scan('r', 's')}/@adv/pub/x/1/_", handler)
    _token = robot_session.liveliness().declare_token(f"{KEYS.scan('r', 's')}/@adv/pub/x/1/_")
    eventually(lambda: is_known(listener))
    take(hold, scan(0), scan(3), scan(4))
    eventually(lambda: recorder.seqs() == [0, 3, 4])
    assert len(kept) == 3
    assert recorder.gone == [("s", "a", 2, [1, 2])]
    assert recorder.why_gone == ["no answer"]
    for query in kept:
        query.drop()


def test_a_cache_that_is_there_and_is_slow_is_asked_for_longer_and_nothing_is_lost(
    hold, recorder, cache, eventually, monkeypatch
):
    monkeypatch.setattr(robot_caches, "SILENT", 60.0)
    publisher, ask, failing = cache(), Caches.ask, [8]

    def slow(self, robot, keys, parameters, account):
        if failing[0]:
            failing[0] -= 1
            return Answer(whole=False)
        return ask(self, robot, keys, parameters, account)

    monkeypatch.setattr(Caches, "ask", slow)
    for seq in range(6):
        publisher.put(scan(seq))
    hold.start()
    take(hold, scan(0), scan(5))
    eventually(lambda: recorder.seqs() == list(range(6)))
    assert recorder.gone == []


def test_nobody_waits_for_robots_whose_caches_do_not_answer(
    listener, recorder, cache, eventually, monkeypatch
):
    monkeypatch.setattr(hold_module, "ASKERS", 1)
    asked, over, ask = [], threading.Event(), Caches.ask

    def ask_in_vain(self, robot, keys, parameters, account):
        if robot == "r":
            return ask(self, robot, keys, parameters, account)
        asked.append(robot)
        if len(asked) > 2:  # each of them was asked once
            over.wait(60.0)
        return Answer(whole=False)

    monkeypatch.setattr(Caches, "ask", ask_in_vain)
    publisher = cache()
    hold = HoldAndAsk(Caches(listener, KEYS, lambda _: 1000), recorder, recorder)
    try:
        for name in ("dead1", "dead2"):
            take(hold, scan(0, name), scan(3, name), source=Source(name, "s"))
        eventually(lambda: len(asked) == 3)
        for seq in range(4):
            publisher.put(scan(seq))
        take(hold, scan(0), scan(3))
        eventually(lambda: recorder.seqs() == [0, 1, 2, 3])
        assert sorted(asked) in (["dead1", "dead1", "dead2"], ["dead1", "dead2", "dead2"])
        over.set()
        eventually(lambda: recorder.seqs(run="dead1") == recorder.seqs(run="dead2") == [0, 3])
        assert sorted(asked) == ["dead1"] * 3 + ["dead2"] * 3
    finally:
        over.set()
        hold.stop()


def test_robots_and_sensors_past_the_limits_are_handed_on_to_be_refused(hold, recorder, asked):
    take(hold, scan(5), source=Source("refused", "s"))
    assert recorder.seqs() == [5]
    for k in range(17):
        take(hold, scan(0), source=Source("r", f"s{k}"))
    take(hold, scan(9), source=Source("r", "s16"))
    assert recorder.seqs("s16") == [0, 9]
    assert asked == []


def test_a_command_comes_after_what_is_held(hold, recorder, cache, eventually):
    publisher = cache()
    publisher.put(scan(0))
    recorder.room = False
    hold.do_in_turn("r", lambda: recorder.handed_on.append(b"before"))
    take(hold, scan(1))
    hold.do_in_turn("r", lambda: recorder.handed_on.append(b"after"))
    assert recorder.handed_on == [b"before"]
    recorder.room = True
    eventually(lambda: len(recorder.handed_on) == 4)
    assert recorder.handed_on == [b"before", ("s", "a", 0), ("s", "a", 1), b"after"]


def test_a_stopped_one_hands_nothing_on(hold, recorder, cache):
    publisher = cache()
    publisher.put(scan(0))
    recorder.room = False
    take(hold, scan(1))
    stopping = threading.Thread(target=hold.stop)
    stopping.start()
    stopping.join(30.0)
    assert not stopping.is_alive()
    assert recorder.handed_on == []
