"""A node of pyzeros, which speaks as rmw_zenoh does: a line of JSON in, a line of JSON out (rclpy_node.py).

Its arguments are its name, the domain and the endpoint of the router. It knows no transient local. Messages
to put are read, and written anew, by its own CDR: scans by `cydr`, all else by `cyclone`.
"""

import asyncio
import sys
from dataclasses import dataclass, field, fields, is_dataclass

import pyzeros
import zenoh
from answering import answer_by_verb
from cyclonedds_idl import types
from pyzeros.builtin_msgs import Attachment
from pyzeros.qos import QosProfile
from pyzeros.sub import RawSub
from pyzeros.utils import rmw_zenoh_gid
from ros2_pyterfaces.cyclone.all_msgs import OccupancyGrid, TransformStamped
from ros2_pyterfaces.cyclone.idl import IdlStruct
from ros2_pyterfaces.cydr.all_msgs import LaserScan
from ros2_pyterfaces.cydr.all_srvs import GetMap


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs/msg/TFMessage"):
    transforms: types.sequence[TransformStamped] = field(default_factory=list)


KINDS = {kind.get_type_name(): kind for kind in (LaserScan, OccupancyGrid, TFMessage)}


class Ends:
    def __init__(self, node):
        self.node, self.publishers, self.found = node, {}, {}

    def publish(self, asked):
        kind, topic = KINDS[asked["type"]], asked["publish"]
        qos = QosProfile.default() if asked["reliable"] else QosProfile.sensor_data()
        publisher = pyzeros.Pub(kind, topic, qos_profile=qos, session=self.node, scope=None)
        self.publishers[topic] = kind, publisher

    def put(self, asked):
        kind, publisher = self.publishers[asked["put"]]
        publisher.publish(kind.deserialize(bytes.fromhex(asked["cdr"])))

    def heard(self, asked):
        return {"count": int(self.publishers[asked["heard"]][1].zenoh_pub.matching_status.matching)}

    def subscribe(self, asked):
        kind, topic, found = KINDS[asked["type"]], asked["subscribe"], []

        def take(sample):
            attached = Attachment.deserialize(b"\0\1\0\0" + sample.attachment.to_bytes())
            found.append((kind.deserialize(sample.payload.to_bytes()), attached))

        self.found[topic] = found, RawSub(kind, topic, take, session=self.node, scope=None)

    def call(self, asked):
        """Ask a GetMap service, once there is one."""

        async def called():
            client = pyzeros.Client(GetMap, asked["call"], session=self.node, scope=None)
            try:
                await client.wait_for_service()
                return await client.call_async(GetMap.Request())
            finally:
                client.undeclare()

        try:
            return {"values": cydr_told(asyncio.run(called()).map)}
        except RuntimeError as error:
            return {"error": str(error)}

    def take(self, asked):
        return {"values": [told(message) for message, _ in self.found[asked["take"]][0]]}

    def attached(self, asked):
        """What came with each message: its number, and whether the publisher is one that tokens tell of."""
        tokens = [str(reply.ok.key_expr) for reply in self.node.session.liveliness().get("@ros2_lv/**")]
        publishers = {bytes(rmw_zenoh_gid(token)) for token in tokens if "/MP/" in token}
        found = [attached for _, attached in self.found[asked["attached"]][0]]
        return {"told": [(int(each.sequence_number), bytes(each.source_gid) in publishers) for each in found]}


def told(value):
    if is_dataclass(value):
        return {each.name: told(getattr(value, each.name)) for each in fields(value)}
    return value if isinstance(value, (str, int, float)) else list(value)


def cydr_told(value):
    if hasattr(value, "__struct_fields__"):
        return {name: cydr_told(getattr(value, name)) for name in value.__struct_fields__}
    value = value.tolist() if hasattr(value, "tolist") else value
    return value.decode() if isinstance(value, bytes) else value


def main():
    name, domain, endpoint = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    namespace, _, name = name.rpartition("/")
    with (
        zenoh.open(config) as session,
        pyzeros.auto_context(name, session, namespace=namespace or "%", domain_id=int(domain)) as node,
    ):
        answer_by_verb(Ends(node))


main()
