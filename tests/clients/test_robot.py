"""What a robot's publisher puts on the network, and what it refuses to."""

import threading
import time

import numpy as np
import pytest
import zenoh

from ogm_client import CannotConnect, ClientError, NobodyAnswered, RobotPublisher
from ogm_client import robot as robot_module
from ogm_client.session import NetworkConfig, open_session
from ogm_core.errors import BadMessage, BadSetting
from ogm_core.status import RobotStatus, encode_status
from ogm_core.types import IDENTITY, Pose, PoseStamped, Scan
from ogm_core.wire import messages
from status_json import STATUS

SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}


@pytest.fixture
def samples(listener):
    """Every sample that reaches a mapper of map `hall`, in order."""
    got = []
    handler = zenoh.handlers.Callback(got.append, indirect=False)
    listener.declare_subscriber("ogm/v1/hall/robots/**", handler)
    return got


@pytest.fixture
def robot(samples, endpoint):
    with RobotPublisher("r1", address=endpoint, map_name="hall") as robot:
        robot.wait_for_mapper(5.0)
        yield robot


@pytest.fixture
def received(samples, eventually):
    """`received(n)` waits for n samples, and gives them as (key, decoded message)."""

    def take(count):
        eventually(lambda: len(samples) >= count)
        assert len(samples) == count
        return [(str(sample.key_expr), decoded(sample)) for sample in samples]

    return take


def decoded(sample):
    payload = sample.payload.to_bytes()
    match str(sample.encoding):
        case "application/msgpack;ogm.Pose.v1":
            return messages.decode_pose(payload)
        case "application/msgpack;ogm.Scan.v1":
            return messages.decode_scan(payload)
    raise AssertionError(sample.encoding)


def assert_same_scan(scan, expected):
    np.testing.assert_array_equal(scan.ranges, expected.ranges)
    assert messages.scan_fields(scan) == messages.scan_fields(expected)


def test_a_pose_arrives_as_it_was_given(robot, received):
    robot.publish_pose(1.0, -2.5, 7.0, stamp=12)
    assert received(1) == [
        ("ogm/v1/hall/robots/r1/pose", PoseStamped(12, Pose(1.0, -2.5, 7.0), 0, robot.run))
    ]


def test_what_is_masked_is_no_measurement(robot, received):
    measured = np.ma.MaskedArray([1.0, 2.0, 3.0], mask=[False, True, False])
    robot.publish_scan(measured, **SWEEP)
    robot.publish_scan(np.ma.MaskedArray([1, 2], mask=False), **SWEEP)
    (_, masked), (_, bare) = received(2)
    np.testing.assert_array_equal(masked.ranges, [1.0, np.nan, 3.0])
    np.testing.assert_array_equal(bare.ranges, [1.0, 2.0])
    np.testing.assert_array_equal(measured.data, [1.0, 2.0, 3.0])


def test_bearings_that_go_round_more_than_twice_are_refused(robot, received):
    angles = {"angle_min": 0.0, "range_min": 0.1, "range_max": 30.0}
    with pytest.raises(BadMessage, match=r"angle_increment: the bearings go 57.1 times round: give radians"):
        robot.publish_scan([1.0] * 360, angle_increment=1.0, **angles)
    robot.publish_scan([1.0] * 721, angle_increment=-np.pi / 180, **angles)
    robot.publish_scan([1.0], angle_increment=0.0, **angles)
    assert [scan.ranges.size for _, scan in received(2)] == [721, 1]


@pytest.mark.parametrize(
    ("ns", "unit"), [(10**9, "seconds"), (10**6, "milliseconds"), (10**3, "microseconds")]
)
def test_a_stamp_in_another_unit_is_warned_of_once(robot, received, ns, unit):
    stamp = (time.time_ns() + 3_600 * 10**9) // ns
    with pytest.warns(UserWarning, match=f"stamp: {stamp} looks like {unit} since 1970; ns") as caught:
        robot.publish_pose(0.0, 0.0, 0.0, stamp=stamp)
    assert [warning.filename for warning in caught] == [__file__]
    robot.publish_scan([1.0], stamp=stamp + 1, **SWEEP)  # another warning would be an error
    assert len(received(2)) == 2


def test_simulated_time_and_the_time_of_now_are_not_warned_of(robot, received):
    for stamp in (0, 5 * 10**9, 3_600 * 10**9, time.time_ns(), None):
        robot.publish_pose(0.0, 0.0, 0.0, stamp=stamp)  # a warning would be an error
    assert len(received(5)) == 5


def test_a_scan_arrives_as_it_was_given(robot, received):
    ranges = [1.5, np.inf, np.nan, 29.875]
    pose, mount = (1, 2, 3), np.array([0.25, 0, -0.5])
    robot.publish_scan(
        ranges, **SWEEP, sensor="front", stamp=np.int64(5), time_increment=1e-4, mount=mount, pose=pose
    )
    [(key, scan)] = received(1)
    assert key == "ogm/v1/hall/robots/r1/scan/front"
    expected = Scan(
        stamp=5,
        **SWEEP,
        ranges=np.array(ranges, np.float32),
        time_increment=1e-4,
        mount=Pose(0.25, 0.0, -0.5),
        pose=Pose(1.0, 2.0, 3.0),
        seq=0,
        run=robot.run,
    )
    assert_same_scan(scan, expected)


def test_what_is_not_given_has_defaults(robot, received):
    before = time.time_ns()
    robot.publish_scan(np.array([1, 2], np.uint8), **SWEEP)
    robot.publish_pose(0, np.float32(0.5), 0)
    after = time.time_ns()
    (scan_key, scan), (_, pose) = received(2)
    assert scan_key == "ogm/v1/hall/robots/r1/scan/laser"
    assert (scan.pose, scan.mount, scan.time_increment) == (None, IDENTITY, 0.0)
    assert pose.pose == Pose(0.0, 0.5, 0.0)
    assert before <= scan.stamp <= pose.stamp <= after


@pytest.mark.parametrize("dtype", [np.float64, ">f4", np.int32])
def test_ranges_of_any_number_type(robot, received, dtype):
    robot.publish_scan(np.array([1, 2, 3, 4], dtype)[::2], **SWEEP)
    np.testing.assert_array_equal(received(1)[0][1].ranges, np.array([1, 3], np.float32))


def test_a_reading_past_float32_is_no_return(robot, received):
    robot.publish_scan([1e300, 1.0], **SWEEP)
    np.testing.assert_array_equal(received(1)[0][1].ranges, [np.inf, 1.0])


def test_each_key_counts_its_own_messages(robot, received):
    for _ in range(3):
        robot.publish_pose(0.0, 0.0, 0.0)
        robot.publish_scan([1.0], **SWEEP)
    robot.publish_scan([1.0], **SWEEP, sensor="rear")
    by_key = {}
    for key, message in received(7):
        by_key.setdefault(key.removeprefix("ogm/v1/hall/robots/r1/"), []).append((message.run, message.seq))
    run = robot.run
    counted = [(run, 0), (run, 1), (run, 2)]
    assert by_key == {"pose": counted, "scan/laser": counted, "scan/rear": [(run, 0)]}


def test_every_publisher_has_a_run_of_its_own(listener):
    with (
        RobotPublisher("r1", session=listener) as first,
        RobotPublisher("r1", session=listener) as second,
        RobotPublisher("r1", session=listener, run="given") as third,
    ):
        assert len({first.run, second.run}) == 2
        assert first.run.isalnum()
        assert third.run == "given"


def test_recorded_messages_keep_their_run_and_seq(robot, received):
    pose = PoseStamped(1, Pose(1.0, 2.0, 3.0), 41, "recorded.run-1")
    scan = Scan(2, **SWEEP, ranges=np.array([1.0, np.inf], np.float32), seq=17, run="other")
    robot.put_pose(pose)
    robot.put_scan("front", scan)
    robot.publish_pose(0.0, 0.0, 0.0, stamp=3)
    (_, got_pose), (key, got_scan), (_, own) = received(3)
    assert got_pose == pose
    assert key == "ogm/v1/hall/robots/r1/scan/front"
    assert_same_scan(got_scan, scan)
    assert (own.run, own.seq) == (robot.run, 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"angle_increment": 0.0}, "angle_increment: it must not be 0"),
        ({"angle_min": np.inf}, "angle_min: a finite number"),
        ({"angle_min": "0"}, "angle_min: a number is needed, got str"),
        ({"angle_min": 10**400}, "angle_min: a finite number"),
        ({"range_min": True}, "range_min: a number is needed, got bool"),
        ({"range_min": 30.0}, "range_min"),
        ({"range_max": 1001.0}, "range_max"),
        ({"time_increment": np.nan}, "time_increment"),
        ({"stamp": -1}, "stamp: 0 to"),
        ({"stamp": 2**64}, "stamp: 0 to"),
        ({"stamp": 1.5}, "stamp: a whole number"),
        ({"stamp": True}, "stamp: a whole number"),
        ({"mount": (0.0, 0.0)}, r"mount: \[x, y, theta\]"),
        ({"mount": (0.0, np.nan, 0.0)}, r"mount\[1\]"),
        ({"pose": (0.0, 0.0, None)}, r"pose\[2\]"),
        ({"pose": 1.0}, r"pose: \[x, y, theta\] is needed, got float"),
        ({"ranges": []}, "ranges: "),
        ({"ranges": [[1.0, 2.0]]}, r"ranges: .*\(1, 2\)"),
        ({"ranges": [1.0, None]}, "ranges: "),
        ({"ranges": [[1.0], [1.0, 2.0]]}, "ranges: "),
        ({"ranges": [True, False]}, "ranges: .*bool"),
        ({"ranges": ["1.0"]}, "ranges: "),
        ({"ranges": np.ones(200_001)}, "ranges: 1 to 200000 beams"),
    ],
)
def test_a_bad_scan_is_refused_and_not_counted(robot, received, change, message):
    with pytest.raises(BadMessage, match=message):
        robot.publish_scan(**{"ranges": [1.0, 2.0], **SWEEP, **change})
    robot.publish_scan([2.0], **SWEEP)
    [(_, scan)] = received(1)
    assert (scan.seq, scan.ranges.tolist()) == (0, [2.0])


def test_a_bad_pose_is_refused_and_not_counted(robot, received):
    with pytest.raises(BadMessage, match="theta"):
        robot.publish_pose(0.0, 0.0, np.nan)
    with pytest.raises(BadMessage, match="pose"):
        robot.publish_pose("1", 0.0, 0.0)
    with pytest.raises(BadMessage, match="x"):
        robot.put_pose(PoseStamped(1, Pose(np.inf, 0.0, 0.0)))
    with pytest.raises(BadMessage, match="range_min"):
        robot.put_scan("laser", Scan(1, **SWEEP | {"range_min": -1.0}, ranges=np.ones(1, np.float32)))
    robot.publish_pose(1.0, 1.0, 1.0)
    assert received(1)[0][1].seq == 0


@pytest.mark.parametrize(
    "names",
    [
        {"robot": "r 1"},
        {"robot": ""},
        {"robot": None},
        {"robot": 7},
        {"map_name": "a/b"},
        {"map_name": None},
        {"run": "*"},
        {"robot": "x" * 65},
    ],
)
def test_a_name_that_cannot_stand_in_a_key_is_refused(listener, names):
    with pytest.raises(BadSetting):
        RobotPublisher(**{"robot": "r1", "session": listener, **names})


def test_a_publisher_waits_for_a_mapper_that_starts_later(endpoint, caplog, eventually):
    made = []
    starting = threading.Thread(target=lambda: made.append(RobotPublisher("r1", address=endpoint)))
    starting.start()
    eventually(lambda: f"waiting for a mapper or a Zenoh router at {endpoint}" in caplog.messages)
    with open_session(NetworkConfig(listen=(endpoint,))) as later:
        starting.join(30.0)
        eventually(lambda: [*later.liveliness().get("ogm/v1/default/alive/robot/r1/*")])
        made[0].close()


@pytest.mark.parametrize("how", [{"wait": False}, {"connect_timeout": 0.1}, {"connect_timeout": 0}])
def test_a_publisher_need_not_wait(endpoint, caplog, how):
    with pytest.raises(CannotConnect, match=f"{endpoint}.*ogm mapper"):
        RobotPublisher("r1", address=endpoint, **how)
    assert not caplog.messages


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"address": "http://127.0.0.1:8000"}, "a URL is no Zenoh endpoint"),
        ({"address": "tcp/127.0.0.1"}, "a host and a port"),
        ({"address": 7447}, "a text such as tcp/127.0.0.1:7447 is needed, got 7447"),
        ({"connect_timeout": -1.0}, "connect_timeout: 0 s or more"),
        ({"connect_timeout": np.nan}, "connect_timeout: 0 s or more"),
    ],
)
def test_a_publisher_says_at_once_what_is_wrong_with_its_address(options, said):
    with pytest.raises(BadSetting, match=said):
        RobotPublisher("r1", **options)


def test_a_sensor_that_cannot_stand_in_a_key_is_refused(robot):
    with pytest.raises(BadSetting, match="sensor"):
        robot.publish_scan([1.0], **SWEEP, sensor="front/left")


@pytest.mark.parametrize(
    ("reliable", "control"), [(False, zenoh.CongestionControl.DROP), (True, zenoh.CongestionControl.BLOCK)]
)
def test_only_a_reliable_robot_waits_for_the_network(samples, endpoint, eventually, reliable, control):
    with RobotPublisher("r1", address=endpoint, map_name="hall", reliable=reliable) as robot:
        robot.wait_for_mapper(5.0)
        robot.publish_pose(0.0, 0.0, 0.0)
        robot.publish_scan([1.0], **SWEEP)
        eventually(lambda: len(samples) == 2)
    assert [sample.congestion_control for sample in samples] == [control, control]


def test_without_a_mapper_waiting_ends(listener, endpoint):
    with RobotPublisher("r1", address=endpoint, map_name="hall") as robot:
        with pytest.raises(NobodyAnswered, match=f"'hall'.*{endpoint}.*--map hall"):
            robot.wait_for_mapper(0.05)
        listener.declare_subscriber("ogm/v1/other/robots/**", zenoh.handlers.Callback(print, indirect=False))
        with pytest.raises(NobodyAnswered):
            robot.wait_for_mapper(0.05)


def test_a_robot_is_alive_while_it_is_open(listener, endpoint, eventually):
    seen = []
    handler = zenoh.handlers.Callback(
        lambda sample: seen.append((str(sample.key_expr), sample.kind)), indirect=False
    )
    listener.liveliness().declare_subscriber("ogm/v1/hall/alive/**", handler)
    key = "ogm/v1/hall/alive/robot/r1/run-7"
    with RobotPublisher("r1", address=endpoint, map_name="hall", run="run-7"):
        eventually(lambda: seen == [(key, zenoh.SampleKind.PUT)])
    eventually(lambda: seen == [(key, zenoh.SampleKind.PUT), (key, zenoh.SampleKind.DELETE)])


def test_a_session_that_was_given_stays_open(listener, endpoint, eventually):
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        with RobotPublisher("r1", session=session) as robot:
            robot.publish_pose(0.0, 0.0, 0.0)
            eventually(lambda: [*listener.liveliness().get("ogm/v1/default/alive/**")])
        assert not session.is_closed()
        eventually(lambda: not [*listener.liveliness().get("ogm/v1/default/alive/**")])


def test_a_closed_publisher_says_so(robot, received):
    robot.publish_pose(1.0, 0.0, 0.0)
    received(1)
    robot.close()
    robot.close()
    with pytest.raises(ClientError, match="closed"):
        robot.publish_pose(2.0, 0.0, 0.0)
    with pytest.raises(ClientError, match="closed"):
        robot.publish_scan([1.0], **SWEEP)
    with pytest.raises(ClientError, match="robot 'r1': the publisher is closed; make a new one"), robot:
        pass
    received(1)


def test_feedback_needs_a_mapper_and_an_open_publisher(listener, endpoint):
    with RobotPublisher("r1", address=endpoint, map_name="hall") as robot:
        with pytest.raises(NobodyAnswered, match=f"'hall' answered at {endpoint}.*--map hall"):
            robot.feedback(timeout=0.2)
        with pytest.raises(BadSetting, match="timeout"):
            robot.feedback(timeout=0.0)
    with pytest.raises(ClientError, match="the publisher is closed"):
        robot.feedback()


def test_feedback_is_of_this_robot(listener, endpoint):
    def answer(query):
        query.reply(query.key_expr, encode_status(STATUS))

    listener.declare_queryable("ogm/v1/hall/status", answer)
    with RobotPublisher("r2", address=endpoint, map_name="hall") as robot:
        assert robot.feedback() == STATUS.robots["r2"]
    with RobotPublisher("unheard", address=endpoint, map_name="hall") as robot:
        assert robot.feedback() == RobotStatus(None, None)


def test_a_session_that_takes_no_token_is_closed_again(monkeypatch):
    """Left open, it would keep the process from ending."""
    closed = []

    class NoTokens:
        def liveliness(self):
            return self

        def declare_token(self, key):
            raise zenoh.ZError(f"no token for {key}")

        def close(self):
            closed.append(True)

    monkeypatch.setattr(robot_module, "open_session", lambda _: NoTokens())
    with pytest.raises(ClientError, match="alive/robot/r1/one: not declared at tcp/x:1: no token for"):
        RobotPublisher("r1", address="tcp/x:1", run="one")
    assert closed == [True]


def test_a_closed_session_that_is_given_is_said(listener):
    listener.close()
    with pytest.raises(ClientError, match="not declared on the open session: session closed"):
        RobotPublisher("r1", session=listener)


def test_a_session_closed_under_the_publisher_is_said(listener, endpoint):
    with (
        open_session(NetworkConfig(connect=(endpoint,))) as session,
        RobotPublisher("r1", session=session) as robot,
    ):
        robot.publish_pose(1.0, 0.0, 0.0)
        session.close()
        with pytest.raises(ClientError, match="not sent"):
            robot.publish_pose(2.0, 0.0, 0.0)
        with pytest.raises(ClientError, match="cannot publish"):
            robot.publish_scan([1.0], **SWEEP)


def test_threads_share_a_publisher(samples, endpoint, eventually):
    each, threads = 200, 4
    with RobotPublisher("r1", address=endpoint, map_name="hall", reliable=True) as robot:
        robot.wait_for_mapper(5.0)

        def publish():
            for _ in range(each):
                robot.publish_pose(0.0, 0.0, 0.0)

        workers = [threading.Thread(target=publish) for _ in range(threads)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        eventually(lambda: len(samples) == each * threads)
    assert [decoded(sample).seq for sample in samples] == list(range(each * threads))
