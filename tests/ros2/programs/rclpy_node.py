"""A node of ROS 2: a line of JSON in, a line of JSON out. Its one argument is its name, as /r1/driver.

{"publish": "/scan", "type": "sensor_msgs/msg/LaserScan", "reliable": true, "latched": false, "depth": 5}
{"put": "/scan", "cdr": "..."}
{"heard": "/scan"}                     ->   {"count": 1}       subscribers that it knows of
{"subscribe": "/map", "type": "nav_msgs/msg/OccupancyGrid", "reliable": true, "latched": true, "depth": 1}
{"take": "/map"}                       ->   {"values": [...]}  all messages so far, as rclpy gives them
{"client": "/get_map"}                                          of nav_msgs/GetMap
{"offered": "/get_map"}                ->   {"value": true}    whether a service is there
{"call": "/get_map"}
{"replied": "/get_map"}                ->   {"values": [...]}  the maps so far
"""

import sys
import threading

import rclpy
from answering import answer_by_verb
from nav_msgs.srv import GetMap
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy_messages import message_class, told


class Ends:
    """What the node publishes and subscribes to, by topic."""

    def __init__(self, node):
        self.node, self.publishers, self.found = node, {}, {}
        self.clients, self.asked = {}, {}

    def publish(self, asked):
        kind = message_class(asked["type"])
        self.publishers[asked["publish"]] = self.node.create_publisher(kind, asked["publish"], qos(asked))

    def put(self, asked):
        self.publishers[asked["put"]].publish(bytes.fromhex(asked["cdr"]))

    def heard(self, asked):
        return {"count": self.publishers[asked["heard"]].get_subscription_count()}

    def subscribe(self, asked):
        found = self.found[asked["subscribe"]] = []
        self.node.create_subscription(
            message_class(asked["type"]), asked["subscribe"], found.append, qos(asked)
        )

    def take(self, asked):
        return {"values": [told(message) for message in self.found[asked["take"]]]}

    def client(self, asked):
        self.clients[asked["client"]] = self.node.create_client(GetMap, asked["client"])
        self.asked[asked["client"]] = []

    def offered(self, asked):
        return {"value": self.clients[asked["offered"]].service_is_ready()}

    def call(self, asked):
        self.asked[asked["call"]].append(self.clients[asked["call"]].call_async(GetMap.Request()))

    def replied(self, asked):
        return {"values": [told(each.result().map) for each in self.asked[asked["replied"]] if each.done()]}


def qos(asked):
    return QoSProfile(
        depth=asked["depth"],
        reliability=ReliabilityPolicy.RELIABLE if asked["reliable"] else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if asked["latched"] else DurabilityPolicy.VOLATILE,
    )


def main():
    rclpy.init()
    namespace, _, name = sys.argv[1].rpartition("/")
    node = Node(name, namespace=namespace or "/")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin)
    spinning.start()
    ends = Ends(node)
    answer_by_verb(ends)
    executor.shutdown()
    spinning.join()
    rclpy.shutdown()


main()
