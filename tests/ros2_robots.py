"""Robots of ROS 2 on Zenoh, as tables of the wire say: by nothing of what is tested."""

import struct
import time

import xxhash
import zenoh
from zenoh import ext

HASHES = {
    "LaserScan": "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    "TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "OccupancyGrid": "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
    "GetMap": "RIHS01_c8ae77c9995b3554b5ba80e4d4d443f970ac65143102a1d893ec24fc07b31147",
}
NO_FIELDS = b"\0\1\0\0\0"
"""A request without a field has one byte."""
PACKAGES = {
    "LaserScan": "sensor_msgs",
    "TFMessage": "tf2_msgs",
    "PointCloud2": "sensor_msgs",
    "Odometry": "nav_msgs",
    "OccupancyGrid": "nav_msgs",
}
BLOCK = {"congestion_control": zenoh.CongestionControl.BLOCK}
"""So that none is lost on a busy machine."""
KEEPS = {"cache": ext.CacheConfig(max_samples=1), "publisher_detection": True}
HEARTBEAT = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5)


def old_attachment(seq, stamp, gid):
    """As before April 2025: each value after its name."""
    found = b""
    for name, value in (
        ("sequence_number", struct.pack("<q", seq)),
        ("source_timestamp", struct.pack("<q", stamp)),
        ("source_gid", bytes([len(gid)]) + gid),
    ):
        found += bytes([len(name)]) + name.encode() + value
    return found


class RmwZenohRobot:
    """A node of rmw_zenoh. `old`: as Humble was, with no hashes and the attachments of before."""

    def __init__(self, session, *, domain=0, namespace="", node="driver", old=False):
        self.session, self.domain, self.old = session, domain, old
        self.head = f"@ros2_lv/{domain}/{session.info.zid()}/0"
        self.tail = f"%/{namespace.replace('/', '%') or '%'}/{node}"
        self.tokens = [self._declare(f"{self.head}/0/NN/{self.tail}")]
        self.publishers = []

    def _declare(self, token):
        return self.session.liveliness().declare_token(token)

    def _token(self, kind, topic, name, qos, type_hash):
        topic = topic.replace("/", "%")
        dds = f"{PACKAGES[name]}::msg::dds_::{name}_"
        return f"{self.head}/{len(self.tokens)}/{kind}/{self.tail}/{topic}/{dds}/{type_hash}/{qos}"

    def publisher(self, topic, name, *, latched=False):
        """What publishes messages of a type, as `LaserScan`, on a topic."""
        type_hash = "TypeHashNotSupported" if self.old else HASHES[name]
        qos = ":1:,1:,:,:,," if latched else "2::,5:,:,:,,"
        token = self._token("MP", topic, name, qos, type_hash)
        self.tokens.append(self._declare(token))
        key = f"{self.domain}/{topic.strip('/')}/{PACKAGES[name]}::msg::dds_::{name}_/{type_hash}"
        number = xxhash.xxh3_128_intdigest(token.encode())
        gid = struct.pack("<QQ", number & (2**64 - 1), number >> 64)
        options = {**KEEPS, "sample_miss_detection": HEARTBEAT} if latched else {}
        publisher = ext.declare_advanced_publisher(self.session, key, **BLOCK, **options)
        self.publishers.append(publisher)
        seq = 0

        def put(payload):
            nonlocal seq
            seq += 1
            attached = (seq, time.time_ns(), gid)
            publisher.put(
                payload,
                attachment=old_attachment(*attached)
                if self.old
                else struct.pack("<qqB16s", attached[0], attached[1], 16, gid),
            )

        put.matching = lambda: bool(session_matching(self.session, key))
        return put

    def subscriber(self, topic, name, take):
        """A subscriber that joins late, as a map display does."""
        type_hash = "TypeHashNotSupported" if self.old else HASHES[name]
        self.tokens.append(self._declare(self._token("MS", topic, name, ":1:,1:,:,:,,", type_hash)))
        key = f"{self.domain}/{topic.strip('/')}/{PACKAGES[name]}::msg::dds_::{name}_/{type_hash}"
        return ext.declare_advanced_subscriber(
            self.session,
            key,
            take,
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
            recovery=ext.RecoveryConfig(heartbeat=True),
            subscriber_detection=True,
        )

    def _services_key(self, name):
        type_hash = "TypeHashNotSupported" if self.old else HASHES["GetMap"]
        return f"{self.domain}/{name.strip('/')}/nav_msgs::srv::dds_::GetMap_/{type_hash}"

    def call(self, name, seq=1, gid=bytes(range(16))):
        """Ask a GetMap service: what is replied, and what goes with it; or what is wrong, as a text."""
        attached = old_attachment(seq, 5, gid) if self.old else struct.pack("<qqB16s", seq, 5, 16, gid)
        return replies(self.session, self._services_key(name), attached)

    def serves(self, name):
        """Tell of a GetMap service, without having one."""
        dds, told = "nav_msgs::srv::dds_::GetMap_", name.replace("/", "%")
        token = f"{self.head}/{len(self.tokens)}/SS/{self.tail}/{told}/{dds}/{HASHES['GetMap']}/::,10:,:,:,,"
        self.tokens.append(self._declare(token))


def replies(session, key, attached):
    """What those reply who say that they have all, as rmw_zenoh and the bridge ask."""
    found = []
    options = {"target": zenoh.QueryTarget.ALL_COMPLETE, "consolidation": zenoh.ConsolidationMode.NONE}
    for reply in session.get(key, payload=NO_FIELDS, attachment=attached, timeout=20.0, **options):
        if reply.ok is None:
            found.append(reply.err.payload.to_string())
        else:
            came = reply.ok.attachment
            assert str(reply.ok.key_expr) == key
            found.append((reply.ok.payload.to_bytes(), came and came.to_bytes()))
    return found


class BridgeRobot:
    """A zenoh-bridge-ros2dds in front of a robot; all of its keys are in its namespace."""

    def __init__(self, session, *, namespace=""):
        self.session, self.namespace = session, namespace
        self.tokens, self.publishers, self.offered = [], [], set()
        self.listening = session.liveliness().declare_subscriber("@/*/@ros2_lv/**", self._told, history=True)

    def _declare(self, kind, topic, name, qos):
        key = f"{self.namespace}{topic}".strip("/")
        told, ros = key.replace("/", "§"), f"{PACKAGES[name]}§msg§{name}"
        token = f"@/{self.session.info.zid()}/@ros2_lv/{kind}/{told}/{ros}/{qos}"
        self.tokens.append(self.session.liveliness().declare_token(token))
        return key

    def publisher(self, topic, name, *, latched=False):
        key = self._declare("MP", topic, name, ":1:1:0,1" if latched else ":0:0:0,5")
        options = {"cache": ext.CacheConfig(max_samples=10), "publisher_detection": True} if latched else {}
        if latched:
            options["sample_miss_detection"] = HEARTBEAT
        publisher = ext.declare_advanced_publisher(self.session, key, **BLOCK, **options)
        self.publishers.append(publisher)

        def put_payload(payload):
            publisher.put(payload)

        put_payload.matching = lambda: bool(session_matching(self.session, key))
        return put_payload

    def subscriber(self, topic, name, take):
        key = self._declare("MS", topic, name, ":1:1:0,1")
        return ext.declare_advanced_subscriber(
            self.session,
            key,
            take,
            history=ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        )

    def call(self, name):
        """Ask a GetMap service, if somebody tells of it; the bridge keeps what it knows the request by."""
        key = f"{self.namespace}{name}".strip("/")
        if f"SS/{key.replace('/', '§')}/nav_msgs§srv§GetMap" not in self.offered:
            return []
        return replies(self.session, key, struct.pack("<Qq", 7, 1))

    def _told(self, sample):
        offered = str(sample.key_expr).partition("/@ros2_lv/")[2]
        (self.offered.add if sample.kind == zenoh.SampleKind.PUT else self.offered.discard)(offered)

    def serves(self, name):
        """Tell of a GetMap service, without having one."""
        key = f"{self.namespace}{name}".strip("/").replace("/", "§")
        token = f"@/{self.session.info.zid()}/@ros2_lv/SS/{key}/nav_msgs§srv§GetMap"
        self.tokens.append(self.session.liveliness().declare_token(token))


def session_matching(session, key):
    """Whether anybody subscribes to a key."""
    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
    try:
        return publisher.matching_status.matching
    finally:
        publisher.undeclare()
