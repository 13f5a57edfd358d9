"""MCAP files as mcap and mcap-ros2-support read them: a line of JSON in, a line of JSON out.

{"file": "drive.mcap"}   ->   {"profile": "ros2", "messages": [["/tf", "tf2_msgs/msg/TFMessage", {...}], ...]}
"""

from answering import answer
from mcap.reader import make_reader
from mcap_messages import told
from mcap_ros2.decoder import DecoderFactory


def read(asked):
    with open(asked["file"], "rb") as file:  # noqa: PTH123 - a program by itself
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        messages = [
            (channel.topic, schema.name, told(message))
            for schema, channel, _, message in reader.iter_decoded_messages()
        ]
        return {"profile": reader.get_header().profile, "messages": messages}


answer(read)
