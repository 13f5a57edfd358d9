"""Messages as mcap-ros2-support reads them: a line of JSON in, a line of JSON out.

{"type": "nav_msgs/msg/OccupancyGrid", "definition": "...", "cdr": "..."}   ->   {"values": {...}}
"""

from answering import answer
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory


def told(value):
    if hasattr(value, "__slots__"):
        return {field: told(getattr(value, field)) for field in value.__slots__}
    return value if isinstance(value, (str, bool, int, float)) else [told(each) for each in value]


def read(asked):
    schema = Schema(id=1, name=asked["type"], encoding="ros2msg", data=asked["definition"].encode())
    message = DecoderFactory().decoder_for("cdr", schema)(bytes.fromhex(asked["cdr"]))
    return {"values": told(message)}


if __name__ == "__main__":
    answer(read)
