"""Channel of a bag's data file: a topic as one writer told it."""

from typing import NamedTuple


class BagChannel(NamedTuple):
    """A channel, named as those of rosbags are.

    `encoding` is that of its `msgcount` messages, as cdr, ros1 or json, and `msgtype` what they are.
    """

    id: int
    topic: str
    msgtype: str
    encoding: str
    msgcount: int
