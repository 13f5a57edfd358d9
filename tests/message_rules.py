"""The rules that every pose and scan keeps, whatever it was read from."""

import math

import numpy as np

from ogm_core.types import PoseStamped
from ogm_core.wire.keys import NAME


def finite(*numbers):
    return all(type(number) is float and math.isfinite(number) for number in numbers)


def check_fields(message):
    """Fail unless a pose or scan message keeps them."""
    assert type(message.stamp) is type(message.seq) is int
    assert 0 <= message.stamp < 2**63
    assert 0 <= message.seq < 2**63
    assert type(message.run) is str
    assert message.run == "" or NAME.fullmatch(message.run)
    if isinstance(message, PoseStamped):
        assert finite(*message.pose)
        return
    assert message.ranges.dtype == np.float32
    assert message.ranges.size > 0
    assert not message.ranges.flags.writeable
    assert finite(message.angle_min, message.angle_increment, message.time_increment)
    assert finite(*message.mount, *(message.pose or ()), message.range_max)
    assert 0.0 <= message.range_min < message.range_max <= 1000.0
    assert message.angle_increment != 0.0 or message.ranges.size == 1
    assert type(message.end_stamp) is int
