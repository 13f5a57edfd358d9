"""A viewer that speaks Foxglove's WebSocket protocol, and a reader of its protobuf messages."""

import json
import struct
import time
from collections import deque
from contextlib import contextmanager

from websockets.sync.client import connect

PATIENCE = 30.0
_VARINT, _DOUBLE, _BYTES = 0, 1, 2


class Viewer:
    """A connection to a server: the channels that it advertises, and what comes on those subscribed to."""

    def __init__(self, socket):
        self._socket = socket
        self.channels = {}
        """Channels by topic, as advertised."""
        self.statuses = []
        """What the server says is wrong, and the ids of what is no more."""
        self._messages = {}
        self._topics = {}

    def channel(self, topic):
        """Wait until a channel is advertised; what is said of it."""
        self._until(lambda: topic in self.channels)
        return self.channels[topic]

    def subscribe(self, topic):
        """Subscribe to a channel that will be advertised, once."""
        if topic in self._messages:
            return
        number = len(self._topics)
        self._topics[number] = topic
        self._messages[topic] = deque()
        asked = {"id": number, "channelId": self.channel(topic)["id"]}
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": [asked]}))

    def unsubscribe(self, topic):
        """Look no longer."""
        numbers = [number for number, name in self._topics.items() if name == topic]
        self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": numbers}))

    def next(self, topic, holds=lambda _: True):
        """Wait for a message on a topic of which that holds, in order; its payload."""
        deadline = time.monotonic() + PATIENCE
        while True:
            self._until(lambda: self._messages[topic], deadline)
            payload = self._messages[topic].popleft()
            if holds(payload):
                return payload

    def gone(self, topic):
        """Wait until a channel is advertised no more."""
        self._until(lambda: topic not in self.channels)

    def told(self, holds):
        """Wait for a status of which that holds."""
        self._until(lambda: any(map(holds, self.statuses)))

    def _until(self, holds, deadline=None):
        deadline = deadline or time.monotonic() + PATIENCE
        while not holds():
            self._take(self._socket.recv(timeout=max(0.0, deadline - time.monotonic())))

    def _take(self, message):
        if isinstance(message, str):
            said = json.loads(message)
            match said["op"]:
                case "advertise":
                    self.channels |= {channel["topic"]: channel for channel in said["channels"]}
                case "unadvertise":
                    self.channels = {
                        topic: channel
                        for topic, channel in self.channels.items()
                        if channel["id"] not in said["channelIds"]
                    }
                case "status" | "removeStatus":
                    self.statuses.append(said)
            return
        opcode, number, _ = struct.unpack_from("<BIQ", message)
        assert opcode == 1
        self._messages[self._topics[number]].append(message[13:])


@contextmanager
def viewing(url):
    """`with viewing(url) as viewer`: connect as Foxglove and Lichtblick do."""
    with connect(url, subprotocols=["foxglove.sdk.v1"], max_size=None, open_timeout=PATIENCE) as socket:
        assert socket.subprotocol == "foxglove.sdk.v1"
        yield Viewer(socket)


def protobuf(payload):
    """The fields of a protobuf message by number, each a list: whole numbers, doubles, or bytes."""
    fields, at = {}, 0
    while at < len(payload):
        tag, at = _varint(payload, at)
        number, kind = divmod(tag, 8)
        if kind == _VARINT:
            value, at = _varint(payload, at)
        elif kind == _DOUBLE:
            (value,) = struct.unpack_from("<d", payload, at)
            at += 8
        else:
            assert kind == _BYTES, kind
            length, at = _varint(payload, at)
            value = payload[at : at + length]
            at += length
        fields.setdefault(number, []).append(value)
    return fields


def _varint(payload, at):
    value = shift = 0
    while True:
        byte = payload[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at


def vector(payload):
    """x, y, z of a Vector3, or x, y, z, w of a Quaternion: what is 0 is not sent."""
    fields = protobuf(payload)
    return tuple(fields.get(number, [0.0])[0] for number in range(1, max(fields, default=0) + 1))
