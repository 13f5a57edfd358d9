"""Messages by ROS 2's own code: a line of JSON in, a line of JSON out.

{"type": "sensor_msgs/msg/LaserScan", "values": {...}}   ->   {"cdr": "00010000..."}
{"type": "sensor_msgs/msg/LaserScan", "cdr": "..."}      ->   {"values": {...}}
{"type": "sensor_msgs/msg/LaserScan"}                    ->   {"hash": "RIHS01_..."}
"""

import json
import sys
from importlib import import_module
from pathlib import Path

from answering import answer
from rclpy.serialization import deserialize_message, serialize_message


def message_class(name):
    package, _, kind = name.replace("/msg/", "/").rpartition("/")
    return getattr(import_module(f"{package}.msg"), kind)


def made(name, values):
    message = message_class(name)()
    fields = message.get_fields_and_field_types()
    for field, value in values.items():
        setattr(message, field, value_of(fields[field], value))
    return message


def value_of(declared, value):
    """`declared` as in "float", "std_msgs/Header", "sequence<sensor_msgs/PointField>", "double[36]"."""
    if isinstance(value, dict):
        return made(declared, value)
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [made(declared[len("sequence<") : -1], each) for each in value]
    return value


def told(value):
    if hasattr(value, "get_fields_and_field_types"):
        return {field: told(getattr(value, field)) for field in value.get_fields_and_field_types()}
    if isinstance(value, (str, bool, int, float)):
        return value
    return [told(each) for each in value] if not hasattr(value, "tolist") else value.tolist()


def type_hash(name):
    """What the installed package states."""
    package, _, kind = name.replace("/msg/", "/").rpartition("/")
    stated = json.loads((Path(sys.prefix) / "share" / package / "msg" / f"{kind}.json").read_text())
    return {each["type_name"]: each["hash_string"] for each in stated["type_hashes"]}[name]


def answered(asked):
    if "values" in asked:
        return {"cdr": serialize_message(made(asked["type"], asked["values"])).hex()}
    if "cdr" in asked:
        message = deserialize_message(bytes.fromhex(asked["cdr"]), message_class(asked["type"]))
        return {"values": told(message)}
    return {"hash": type_hash(asked["type"])}


if __name__ == "__main__":
    answer(answered)
