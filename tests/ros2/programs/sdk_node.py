"""A node of zenoh-ros2-sdk, which speaks as rmw_zenoh does: a line of JSON in and out, as in rclpy_node.py.

Its arguments are its name, the domain, the port of the router and a folder of packages with definitions of
messages. It keeps none for who comes late. Messages to put are read, and written anew, by its store of types.
"""

import os
import sys

from answering import answer_by_verb


class Ends:
    def __init__(self, name, domain, port):
        namespace, _, node = name.rpartition("/")
        self.where = {
            "node_name": node,
            "namespace": namespace or "/",
            "domain_id": int(domain),
            "router_ip": "127.0.0.1",
            "router_port": int(port),
        }
        self.publishers, self.found = {}, {}

    def publish(self, asked):
        topic = asked["publish"]
        self.publishers[topic] = ROS2Publisher(topic=topic, msg_type=asked["type"], **self.where)

    def put(self, asked):
        publisher = self.publishers[asked["put"]]
        read = publisher.session_mgr.store.deserialize_cdr(bytes.fromhex(asked["cdr"]), publisher.msg_type)
        publisher.publish(
            **{name: getattr(read, name) for name in read.__dataclass_fields__ if name[0] != "_"}
        )

    def heard(self, asked):
        return {"count": int(self.publishers[asked["heard"]].pub.matching_status.matching)}

    def subscribe(self, asked):
        found, durability = [], QosDurability.TRANSIENT_LOCAL if asked["latched"] else QosDurability.VOLATILE
        profile = QosProfile(durability=durability, history_depth=asked["depth"])
        options = {"msg_type": asked["type"], "callback": found.append, "qos": profile}
        self.found[asked["subscribe"]] = (
            found,
            ROS2Subscriber(topic=asked["subscribe"], **options, **self.where),
        )

    def call(self, asked):
        """Ask a GetMap service, which it does not wait for; it finds no type without a package."""
        defined = {"request_definition": "# no field", "response_definition": "nav_msgs/OccupancyGrid map"}
        client = ROS2ServiceClient(asked["call"], "nav_msgs/srv/GetMap", **defined, **self.where)
        client.session_mgr.register_message_type(None, "nav_msgs/msg/OccupancyGrid")
        reply = client.call()
        return {"values": told(reply.map)} if reply else {"error": "no reply"}

    def take(self, asked):
        return {"values": [told(message) for message in self.found[asked["take"]][0]]}

    def told(self, asked):
        """Who publishes a topic, as its own discovery says."""
        where = {name: self.where[name] for name in ("domain_id", "router_ip", "router_port")}
        topic = get_topic_info(asked["told"], **where, timeout=2.0, verbose=True)
        found = []
        for each in topic.publishers if topic else ():
            qos = QosProfile.decode(each.qos)
            told = [each.node_namespace, each.node_name, each.topic_type, each.type_hash]
            found.append([*told, qos.reliability.name, qos.durability.name, qos.history_depth])
        return {"publishers": found}


def told(value):
    if hasattr(value, "__dataclass_fields__"):
        return {name: told(getattr(value, name)) for name in value.__dataclass_fields__ if name[0] != "_"}
    if isinstance(value, (str, bool, int, float)):
        return value
    return value.tolist() if hasattr(value, "tolist") else [told(each) for each in value]


name, domain, port, definitions = sys.argv[1:]
os.environ["ZENOH_CONFIG_OVERRIDE"] = (
    f'mode="client";connect/endpoints=["tcp/127.0.0.1:{port}"];listen/endpoints=[];scouting/multicast/enabled=false'
)

from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2Subscriber  # noqa: E402 - it reads the variable
from zenoh_ros2_sdk.discovery import get_topic_info  # noqa: E402
from zenoh_ros2_sdk.message_registry import get_registry  # noqa: E402
from zenoh_ros2_sdk.qos import QosDurability, QosProfile  # noqa: E402

get_registry(definitions)
answer_by_verb(Ends(name, domain, port))
os._exit(0)  # its threads go on
