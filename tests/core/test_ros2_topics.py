import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from ogm_core.errors import BadSetting
from ogm_core.ros2 import bridge_names, cdr, rmw_zenoh_names, services
from ogm_core.ros2.rmw_zenoh_names import Entity
from ogm_core.ros2.topics import TYPE_HASHES, Qos, Topic, check_topic, dds_type, ros_type
from ogm_core.ros2.typestore import typestore

SAMPLES = Path(__file__).parents[1] / "data" / "ros2"
SCAN_HASH = "RIHS01_64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"
"""As FACTS and the published JSON of Jazzy and Kilted have it."""
ZID = "f010750608b72fa54ef9e4dac6f5fb90"
TALKER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,"
)
"""From the design page of rmw_zenoh."""
HUMBLE = (
    "@ros2_lv/0/c40c0137f1e48f6cfee1f90b51ffd9aa/0/5/MP/%/%/mrm_handler/%system%fail_safe%mrm_state/"
    "std_msgs::msg::dds_::Int32_/TypeHashNotSupported/1:2:1,10:,:,:,,"
)


def sample(name):
    return json.loads((SAMPLES / f"{name}.json").read_text())


def test_hashes_are_those_that_distributions_have():
    for store in (Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS2_KILTED):
        types = get_typestore(store)
        for name, known in TYPE_HASHES.items():
            if name != cdr.OCCUPANCY_GRID_UPDATE:  # rosbags does not know it
                assert types.hash_rihs01(name) == known
    assert TYPE_HASHES[cdr.LASER_SCAN] == SCAN_HASH


def test_the_update_s_hash_follows_from_its_definition():
    types = typestore()
    assert types.hash_rihs01(cdr.OCCUPANCY_GRID_UPDATE) == TYPE_HASHES[cdr.OCCUPANCY_GRID_UPDATE]


def test_tokens_of_others():
    assert rmw_zenoh_names.read_token(TALKER) == Topic(
        "rmw_zenoh",
        "/chatter",
        "std_msgs/msg/String",
        "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        Qos(True, False, 7),
        "/talker",
        2,
    )
    humble = rmw_zenoh_names.read_token(HUMBLE)
    assert (humble.name, humble.type, humble.type_hash, humble.domain) == (
        *("/system/fail_safe/mrm_state", "std_msgs/msg/Int32"),
        *("", 0),
    )
    assert humble.qos == Qos(True, False, 10)
    assert rmw_zenoh_names.read_token(f"{TALKER}/cpu") == rmw_zenoh_names.read_token(TALKER)


def test_a_publisher_s_token_key_and_gid_are_those_of_an_independent_writer():
    for name, topic in {
        "map_out": Topic(
            *("rmw_zenoh", "/map", cdr.OCCUPANCY_GRID, TYPE_HASHES[cdr.OCCUPANCY_GRID]),
            *(Qos(True, True, 1), "/zenoh_ogm", 0),
        ),
        "pyzeros_laserscan": Topic(
            *("rmw_zenoh", "/robot1/scan", cdr.LASER_SCAN, SCAN_HASH, Qos(False, False, 5)),
            *("/robot1/driver", 0),
        ),
    }.items():
        told = sample(name)
        token = told.get("token") or told["tokens"][1]
        written = told if "token" in told else told["samples"][0]
        zid = token.split("/")[2]
        assert rmw_zenoh_names.topic_token(topic, Entity(zid, 0, 1)) == token
        assert rmw_zenoh_names.read_token(token) == topic
        assert rmw_zenoh_names.data_key(0, topic.name, topic.type, topic.type_hash) == written["key"]
        attached = bytes.fromhex(written["attachment_hex"])
        assert rmw_zenoh_names.gid(token) == attached[17:]
        seq, stamp = (int.from_bytes(attached[start : start + 8], "little") for start in (0, 8))
        assert rmw_zenoh_names.attachment(seq, stamp, attached[17:]) == attached


def test_a_node_s_token_is_that_of_an_independent_writer():
    written = sample("pyzeros_laserscan")["tokens"][0]
    assert rmw_zenoh_names.node_token(0, Entity(ZID, 0, 1), "/robot1/driver") == written
    assert "/NN/%/%/zenoh_ogm" in rmw_zenoh_names.node_token(0, Entity(ZID, 0, 1), "/zenoh_ogm")


NAMES = st.from_regex(r"(/[A-Za-z_][A-Za-z0-9_]{0,8}){1,4}", fullmatch=True)
QOS = st.builds(Qos, st.booleans(), st.booleans(), st.integers(0, 10_000))


@given(
    NAMES, NAMES, st.sampled_from(list(TYPE_HASHES)), QOS, st.integers(0, 232), st.booleans(), st.booleans()
)
def test_every_topic_s_token_reads_back(name, node, message_type, qos, domain, hashed, publisher):
    type_hash = TYPE_HASHES[message_type] if hashed else ""
    topic = Topic("rmw_zenoh", name, message_type, type_hash, qos, node, domain, publisher)
    assert rmw_zenoh_names.read_token(rmw_zenoh_names.topic_token(topic, Entity(ZID, 3, 7))) == topic


@given(st.text(max_size=40) | st.lists(st.text(max_size=9), max_size=16).map("/".join))
def test_what_is_no_token_is_none(text):
    assert rmw_zenoh_names.read_token(text) is None
    assert bridge_names.read_token(text) is None


@pytest.mark.parametrize(
    ("place", "part"),
    [(0, "@ros2"), (1, "x"), (1, "-1"), (5, "SS"), (9, "%a b"), (9, "chatter"), (10, "String"), (12, "::,x")],
)
def test_a_token_with_one_wrong_part_is_none(place, part):
    parts = TALKER.split("/")
    parts[place] = part
    assert rmw_zenoh_names.read_token("/".join(parts)) is None


def test_a_topic_needs_a_domain_and_none_is_not_0():
    topic = Topic("rmw_zenoh", "/a", cdr.LASER_SCAN, node="/b", domain=None)
    with pytest.raises(ValueError, match="domain"):
        rmw_zenoh_names.topic_token(topic, Entity(ZID, 0, 0))
    assert rmw_zenoh_names.read_token(HUMBLE).domain == 0
    assert bridge_names.read_token(f"@/{ZID}/@ros2_lv/MP/a/a§msg§B/:::,").domain is None


def test_tokens_of_the_bridge():
    token = f"@/{ZID}/@ros2_lv/MP/bot1§scan/sensor_msgs§msg§LaserScan/:0:0:0,5"
    assert bridge_names.read_token(token) == Topic(
        "bridge", "/bot1/scan", cdr.LASER_SCAN, qos=Qos(False, False, 5)
    )
    durable = token.replace(":0:0:0,5", f":1:1:1,-1:typehash={SCAN_HASH};").replace("MP", "MS")
    assert bridge_names.read_token(durable) == Topic(
        "bridge", "/bot1/scan", cdr.LASER_SCAN, SCAN_HASH, Qos(True, True, 0), publisher=False
    )
    assert bridge_names.read_token(token.replace(":0:0:0,5", "K::1:,")).qos == Qos(True, True, 1)
    assert bridge_names.read_token(token.replace("MP", "SS")) is None
    assert bridge_names.data_key("/bot1/scan") == "bot1/scan"


def test_names():
    topic = Topic("dds", "/a/b/scan", cdr.LASER_SCAN)
    assert (topic.namespace, topic.last, Topic("dds", "/tf", cdr.TF_MESSAGE).namespace) == (
        "/a/b",
        "scan",
        "",
    )
    assert dds_type(cdr.LASER_SCAN) == "sensor_msgs::msg::dds_::LaserScan_"
    assert ros_type("sensor_msgs::msg::dds_::LaserScan_") == cdr.LASER_SCAN
    assert ros_type("LaserScan") is None
    assert str(Qos(False, True, 0)) == "best effort, transient local, all"
    assert str(Qos()) == "reliable, last 10"
    assert check_topic("/ogm/map", "--publish-map") == "/ogm/map"
    for wrong in ("map", "/", "/map/", "/a//b", "/2d", "/a b", "/a%b"):
        with pytest.raises(BadSetting, match="--publish-map: a topic's full name"):
            check_topic(wrong, "--publish-map")


def test_tokens_of_services():
    service = Topic(
        "rmw_zenoh", "/ogm/get_map", services.GET_MAP, services.GET_MAP_HASH, services.QOS, "/ogm", 3
    )
    token = rmw_zenoh_names.service_token(service, Entity("ab12", 0, 7))
    assert token == (
        f"@ros2_lv/3/ab12/0/7/SS/%/%/ogm/%ogm%get_map/nav_msgs::srv::dds_::GetMap_/{services.GET_MAP_HASH}"
        "/::,10:,:,:,,"
    )
    assert rmw_zenoh_names.read_service_token(token) == service
    assert rmw_zenoh_names.read_token(token) is None
    assert rmw_zenoh_names.read_service_token(token.replace("/SS/", "/SC/")) is None
    assert rmw_zenoh_names.read_service_token(TALKER) is None
    token = bridge_names.service_token("ab12", "/ogm/get_map", services.GET_MAP)
    assert token == "@/ab12/@ros2_lv/SS/ogm§get_map/nav_msgs§srv§GetMap"
    assert bridge_names.read_service_token(token) == Topic("bridge", "/ogm/get_map", services.GET_MAP)
    assert bridge_names.read_token(token) is None
    assert bridge_names.read_service_token("@/ab12/@ros2_lv/SC/ogm§get_map/nav_msgs§srv§GetMap") is None


def test_what_goes_with_a_reply_is_what_came_with_the_request_and_the_time():
    asked = rmw_zenoh_names.attachment(2**40, 5, bytes(range(16)))
    assert rmw_zenoh_names.reply_attachment(asked, 99) == rmw_zenoh_names.attachment(
        2**40, 99, bytes(range(16))
    )
    of_before = b"\x0fsequence_number" + bytes(8)
    assert rmw_zenoh_names.reply_attachment(of_before, 99) == of_before


def test_the_service_of_a_topic_is_beside_it():
    names = {"/ogm/map": "/ogm/get_map", "/map": "/get_map", "/r1/ogm/map": "/r1/ogm/get_map"}
    assert {topic: services.get_map_service(topic) for topic in names} == names
