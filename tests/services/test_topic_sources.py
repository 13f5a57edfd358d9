"""Topics of ROS 2 on DDS, rmw_zenoh and the bridge: listed, read, and published for who comes late."""

import random
import threading

import pytest

import naive_cdr
from gateway_desk import sessions
from ogm_core.errors import BadSetting
from ogm_core.ros2 import cdr
from ogm_core.ros2.topics import Qos, Topic
from ogm_services.ros2.bridge import BridgeSource
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from ros2_robots import HASHES, BridgeRobot, RmwZenohRobot

STATIC = naive_cdr.tf_message([(0, "base", "laser", (0.1, 0, 0.2, 0, 0, 0, 1))])
SCAN = naive_cdr.laser_scan(5, "laser", (0, 0, 0.1, 0, 0, 0.1, 10), [1.0, 2.0])
NUMBERS = [
    "angle_min",
    "angle_max",
    "angle_increment",
    "time_increment",
    "scan_time",
    "range_min",
    "range_max",
]
GRID = naive_cdr.occupancy_grid(0, "map", 0.05, (2, 3), (-1.0, -2.0), [0, 100, -1, 0, 100, -1])


@pytest.fixture
def join(listener, endpoint):
    """`join()` opens a session of its own on the network."""
    with sessions(endpoint) as join:
        yield join


@pytest.fixture(params=["rmw_zenoh", "humble", "bridge"])
def network(request, join):
    """A source, and a robot in its form."""
    if request.param == "bridge":
        source, robot = BridgeSource(join(), "here"), BridgeRobot(join(), namespace="/r1")
    else:
        old = request.param == "humble"
        source = RmwZenohSource(join(), 3, "here")
        robot = RmwZenohRobot(join(), domain=3, namespace="/r1", old=old)
    yield source, robot
    source.close()


def named(source, name):
    return next((topic for topic in source.topics() if topic.name == name), None)


def full(robot, name):
    return name if isinstance(robot, BridgeRobot) else f"/r1{name}"


def test_what_robots_publish_is_listed_and_read(network, eventually):
    source, robot = network
    put_static = robot.publisher(full(robot, "/tf_static"), "TFMessage", latched=True)
    put_static(STATIC)
    put_scan = robot.publisher(full(robot, "/scan"), "LaserScan")
    topic = eventually(lambda: named(source, "/r1/scan"))
    expected_node = {"bridge": ""}.get(source.form, "/r1/driver")
    expected_hash = HASHES["LaserScan"] if source.form == "rmw_zenoh" and not robot.old else ""
    assert topic == Topic(
        *(source.form, "/r1/scan", cdr.LASER_SCAN, expected_hash),
        *(Qos(False, False, 5), expected_node, source.domain),
    )
    static = eventually(lambda: named(source, "/r1/tf_static"))
    assert static.qos.transient_local
    scans, transforms = [], []
    late = source.subscribe(static, transforms.append)  # after it was said
    taken = source.subscribe(topic, scans.append)
    eventually(lambda: transforms)
    eventually(put_scan.matching)
    put_scan(SCAN)
    eventually(lambda: scans)
    assert (transforms, scans) == ([STATIC], [SCAN])
    taken.close()
    late.close()
    eventually(lambda: not put_scan.matching())


def test_static_transforms_of_two_publishers_come_late_and_later(network, join, eventually):
    source, robot = network
    topic = full(robot, "/tf_static")
    robot.publisher(topic, "TFMessage", latched=True)(STATIC)
    found = []
    subscription = source.subscribe(eventually(lambda: named(source, "/r1/tf_static")), found.append)
    other = type(robot)(join(), **{"namespace": "/r1"} | ({} if source.form == "bridge" else {"domain": 3}))
    second = naive_cdr.tf_message([(0, "base", "camera", (0, 0, 1, 0, 0, 0, 1))])
    other.publisher(topic, "TFMessage", latched=True)(second)
    eventually(lambda: len(found) == 2)
    assert sorted(found) == sorted([STATIC, second])
    subscription.close()


def test_topics_go_with_their_robot(network, eventually):
    source, robot = network
    robot.publisher(full(robot, "/scan"), "LaserScan")
    eventually(lambda: named(source, "/r1/scan"))
    robot.session.close()
    eventually(lambda: not source.topics())


def test_who_comes_late_gets_the_last_map(network, eventually):
    source, robot = network
    latched = source.publish_latched("/r1/map", cdr.OCCUPANCY_GRID)
    latched.put(b"first")
    latched.put(GRID)
    found = []
    came = threading.Event()

    def take(sample):
        found.append(sample)
        came.set()

    subscriber = robot.subscriber(full(robot, "/map"), "OccupancyGrid", take)

    def served():
        latched.look()
        return found

    eventually(served)
    assert found[-1].payload.to_bytes() == GRID
    assert not any(topic.publisher for topic in source.topics())  # ours is not another's
    if source.form == "rmw_zenoh":
        attached = found[-1].attachment.to_bytes()
        assert len(attached) == 33
        assert int.from_bytes(attached[:8], "little") >= 1
    latched.close()
    subscriber.undeclare()


def test_one_domain_does_not_hear_the_other(join, eventually):
    session = join()
    sources = [RmwZenohSource(session, domain, "here") for domain in (0, 3)]
    robots = [RmwZenohRobot(join(), domain=domain) for domain in (0, 3)]
    puts = [robot.publisher("/scan", "LaserScan") for robot in robots]
    found = [[], []]
    for source, taken in zip(sources, found, strict=True):
        topic = eventually(lambda source=source: named(source, "/scan"))
        assert topic.domain == source.domain
        source.subscribe(topic, taken.append)
    eventually(lambda: all(put.matching() for put in puts))
    for put, payload in zip(puts, (SCAN, STATIC), strict=True):
        put(payload)
    eventually(lambda: all(found))
    assert found == [[SCAN], [STATIC]]


@pytest.fixture
def domain():
    """A domain of DDS that nobody else is in, by all odds."""
    pytest.importorskip("cyclonedds", reason="the extra dds is not installed")
    return random.randint(1, 101)


def nodes_told(size, nodes):
    """What a participant says of its nodes in /r1; an id takes `size` bytes."""
    written = naive_cdr.Cdr()
    written.body += b"\7" * size
    written.put("I", len(nodes))
    for name, writers in nodes.items():
        written.text("/r1").text(name).put("I", 0).put("I", len(writers))
        for guid in writers:
            written.body += guid.ljust(size, b"\0")
    return written.bytes


class DdsRobot:
    """A participant of its own, with types that are written out."""

    def __init__(self, domain):
        from cyclonedds import core, idl, util
        from cyclonedds import domain as dds_domain

        types = idl.types
        made = idl.make_idl_struct
        self.policy, self.seconds = core.Policy, util.duration(seconds=1)
        self.participant = dds_domain.DomainParticipant(domain)
        self.time = made(
            "Time", "builtin_interfaces::msg::dds_::Time_", {"sec": types.int32, "nanosec": types.uint32}
        )
        self.header = made("Header", "std_msgs::msg::dds_::Header_", {"stamp": self.time, "frame_id": str})
        numbers = dict.fromkeys(NUMBERS, types.float32)
        rows = dict.fromkeys(("ranges", "intensities"), types.sequence[types.float32])
        self.scan = made(
            "LaserScan", "sensor_msgs::msg::dds_::LaserScan_", {"header": self.header, **numbers, **rows}
        )

    def qos(self, *, latched):
        from cyclonedds.core import Qos as DdsQos

        reliability, durability = self.policy.Reliability, self.policy.Durability
        if latched:
            reliable = reliability.Reliable(self.seconds)
            return DdsQos(reliable, durability.TransientLocal, self.policy.History.KeepLast(1))
        return DdsQos(reliability.BestEffort, durability.Volatile, self.policy.History.KeepLast(5))

    def writer(self, name, kind, *, latched=False):
        from cyclonedds import pub, topic

        qos = self.qos(latched=latched)
        return pub.DataWriter(self.participant, topic.Topic(self.participant, name, kind, qos=qos), qos=qos)

    def reader(self, name, kind):
        from cyclonedds import sub, topic

        qos = self.qos(latched=True)
        return sub.DataReader(self.participant, topic.Topic(self.participant, name, kind, qos=qos), qos=qos)


@pytest.fixture
def on_dds(domain):
    """A source on loopback, and a robot."""
    from ogm_services.ros2.dds import DdsSource

    source = DdsSource(domain, "lo")
    yield source, DdsRobot(domain)
    source.close()


def test_scans_on_dds(on_dds, domain, eventually):
    source, robot = on_dds
    assert source.where == f"DDS on lo, domain {domain}"
    writer = robot.writer("rt/r1/scan", robot.scan)
    topic = eventually(lambda: named(source, "/r1/scan"))
    assert topic == Topic("dds", "/r1/scan", cdr.LASER_SCAN, "", Qos(False, False, 5), "", domain)
    found = []
    subscription = source.subscribe(topic, found.append)
    header = robot.header(robot.time(7, 250_000_000), "laser")
    message = robot.scan(header, 0.0, 1.0, 0.5, 0.0, 0.1, 0.25, 8.0, [1.0, 2.5, 3.0], [])

    def read():
        writer.write(message)
        return found

    scan = cdr.decode_laser_scan(eventually(read)[0])
    assert (scan.stamp, scan.frame, scan.angle_increment) == (7_250_000_000, "laser", 0.5)
    assert (scan.range_min, scan.range_max, scan.ranges.tolist()) == (0.25, 8.0, [1.0, 2.5, 3.0])
    subscription.close()


def test_a_late_static_transform_on_dds(on_dds, eventually):
    from ogm_services.ros2.dds_types import raw_type, sample_of

    source, robot = on_dds
    writer = robot.writer("rt/tf_static", raw_type(cdr.TF_MESSAGE), latched=True)
    writer.write(sample_of(cdr.TF_MESSAGE, STATIC))
    topic = eventually(lambda: named(source, "/tf_static"))
    assert topic.qos == Qos(True, True, 1)
    found = []
    subscription = source.subscribe(topic, found.append)
    eventually(lambda: found)
    assert cdr.decode_tf_message(found[0]) == cdr.decode_tf_message(STATIC)
    subscription.close()


def test_who_comes_late_on_dds_gets_the_last_map(on_dds, eventually):
    from ogm_services.ros2.dds_types import raw_type

    source, robot = on_dds
    latched = source.publish_latched("/map", cdr.OCCUPANCY_GRID)
    latched.put(naive_cdr.occupancy_grid(0, "map", 0.05, (1, 1), (0.0, 0.0), [0]))
    latched.put(GRID)
    reader = robot.reader("rt/map", raw_type(cdr.OCCUPANCY_GRID))
    (sample,) = eventually(lambda: reader.take(9))
    assert sample.payload[:-2].replace(b"\0", b"\xee") == GRID.replace(
        b"\0", b"\xee"
    )  # gaps apart, and 2 more
    assert not any(topic.publisher for topic in source.topics())
    latched.close()


@pytest.mark.parametrize("size", [16, 24])
def test_names_of_nodes_on_dds(on_dds, eventually, size):
    from ogm_core.ros2 import node_names
    from ogm_services.ros2.dds_types import raw_type

    source, robot = on_dds
    writer = robot.writer("rt/scan", robot.scan)
    kind = raw_type(node_names.TYPE, opaque=True)
    told, sample = robot.writer(node_names.TOPIC, kind, latched=True), kind.__new__(kind)
    sample.payload = nodes_told(size, {"driver": [writer.guid.bytes], "other": []})
    told.write(sample)
    eventually(lambda: getattr(named(source, "/scan"), "node", "") == "/r1/driver")


def test_names_of_nodes_that_many_participants_tell_at_once(on_dds, eventually):
    """As for who comes late: nothing is read until all of them have told."""
    from ogm_core.ros2 import node_names
    from ogm_services.ros2.dds_types import raw_type

    source, robot = on_dds
    kind = raw_type(node_names.TYPE, opaque=True)
    names = [f"driver{k}" for k in range(8)]
    scans = [robot.writer(f"rt/{name}", robot.scan) for name in names]
    tell = [robot.writer(node_names.TOPIC, kind, latched=True) for _ in names]
    last = robot.reader("rt/last", kind)
    eventually(lambda: all(named(source, f"/{name}") for name in names))
    with source._reading._lock:
        for name, scan, told in zip(names, scans, tell, strict=True):
            sample = kind.__new__(kind)
            sample.payload = nodes_told(16, {name: [scan.guid.bytes]})
            told.write(sample)
        robot.writer("rt/last", kind, latched=True).write(sample)
        eventually(lambda: last.take(1))
    eventually(
        lambda: [named(source, f"/{name}").node for name in names] == [f"/r1/{name}" for name in names]
    )


def test_dds_of_a_wrong_domain_or_interface(domain):
    from ogm_services.ros2.dds import DdsSource
    from ogm_services.ros2.dds_config import chosen_interface

    with pytest.raises(BadSetting, match="--domain: 0 to 232 are needed, got 233"):
        DdsSource(233, "lo")
    with pytest.raises(BadSetting, match=r"--interface nowhere0: this machine has .*lo"):
        chosen_interface("nowhere0")
    assert chosen_interface("lo") == "lo"
