"""Hashes of message types as ROS 2's own generators compute them: a line of JSON in, a line of JSON out.

{"type": "ogm_msgs/msg/Pose", "definition": "float64 x\\n"}   ->   {"hash": "RIHS01_..."}
"""

import contextlib
import json
import sys
import tempfile
from pathlib import Path

from answering import answer
from rosidl_adapter.msg import convert_msg_to_idl
from rosidl_generator_type_description import generate_type_hash


def answered(asked):
    package, kind, name = asked["type"].split("/")
    with tempfile.TemporaryDirectory() as made, contextlib.redirect_stdout(sys.stderr):
        folder = Path(made)
        (folder / kind).mkdir()
        (folder / kind / f"{name}.msg").write_text(asked["definition"])
        convert_msg_to_idl(folder, package, Path(kind, f"{name}.msg"), folder / kind)
        arguments = folder / "arguments.json"
        tuples = [f"{folder}:{kind}/{name}.idl"]
        arguments.write_text(
            json.dumps({"package_name": package, "output_dir": str(folder / "out"), "idl_tuples": tuples})
        )
        (described,) = generate_type_hash(str(arguments))
        hashes = {
            each["type_name"]: each["hash_string"]
            for each in json.loads(described.read_text())["type_hashes"]
        }
    return {"hash": hashes[asked["type"]]}


answer(answered)
