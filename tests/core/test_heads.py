"""Heads of messages: what is read in place is what the decoders read."""

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ogm_core.errors import BadMessage
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_core.wire.heads import number_of, numbered_so, read_head
from ogm_core.wire.messages import decode_pose, decode_scan, encode_pose, encode_scan

INTS = st.one_of(st.integers(0, 300), st.integers(0, 2**63 - 1), st.sampled_from([127, 128, 2**16, 2**32]))
RUNS = st.text("ab09_-.Z", max_size=64)


@given(INTS, INTS, RUNS)
def test_the_head_of_a_pose_is_that_of_the_decoded_pose(stamp, seq, run):
    payload = encode_pose(PoseStamped(stamp, Pose(1.0, 2.0, 3.0), seq, run))
    decoded = decode_pose(payload)
    assert read_head(payload) == (decoded.stamp, decoded.seq, decoded.run) == (stamp, seq, run)


@given(INTS, INTS, RUNS, st.integers(1, 400))
def test_the_head_of_a_scan_is_that_of_the_decoded_scan(stamp, seq, run, beams):
    scan = Scan(stamp, 0.0, 0.1, 0.1, 30.0, np.ones(beams, np.float32), seq=seq, run=run)
    payload = encode_scan(scan)
    decoded = decode_scan(payload)
    assert read_head(payload) == (decoded.stamp, decoded.seq, decoded.run) == (stamp, seq, run)


@given(INTS, INTS, RUNS, st.permutations(["stamp", "seq", "run", "x", "y", "theta"]))
def test_fields_may_come_in_any_order(stamp, seq, run, order):
    fields = {"stamp": stamp, "seq": seq, "run": run, "x": 0.0, "y": 1, "theta": 2.0}
    assert read_head(msgpack.packb({name: fields[name] for name in order})) == (stamp, seq, run)


def test_a_message_without_a_run_has_the_run_of_no_name():
    assert read_head(msgpack.packb({"stamp": 2**40, "seq": 5, "x": 0})) == (2**40, 5, "")


@given(st.binary(max_size=60), st.binary(max_size=40))
def test_whatever_is_sent_is_a_head_or_none(start, rest):
    whole = encode_pose(PoseStamped(2**60, Pose(0.0, 0.0, 0.0), 70_000, "run"))
    for payload in (start + rest, whole[: len(start)], whole[: len(start)] + rest):
        head = read_head(payload)
        try:
            decoded = decode_pose(payload)
        except BadMessage:
            continue
        assert head == (decoded.stamp, decoded.seq, decoded.run)


@pytest.mark.parametrize(
    "fields",
    [
        {"stamp": 2**63, "seq": 0, "run": "a"},
        {"stamp": 2**60, "seq": 2**63, "run": "a"},
        {"stamp": 2**60, "seq": -1, "run": "a"},
        {"stamp": 2**60, "seq": True, "run": "a"},
        {"stamp": 2**60, "seq": 1, "run": "a b"},
        {"stamp": 2**60, "seq": 1, "run": "é"},
        {"stamp": 2**60, "seq": 1, "run": "x" * 65},
        {"stamp": 2**60, "seq": 1, "run": 5},
        {"stamp": 2**60, "run": "a"},
    ],
)
def test_a_head_that_no_decoder_takes_is_none(fields):
    assert read_head(msgpack.packb({**fields, "x": 0.0, "y": 0.0, "theta": 0.0})) is None


@given(st.integers(2**32, 2**63 - 1), INTS, INTS, RUNS, RUNS)
def test_a_number_is_known_in_a_message_as_it_stands_there(stamp, seq, other, run, other_run):
    payload = encode_pose(PoseStamped(stamp, Pose(1.0, 2.0, 3.0), seq, run))
    assert numbered_so(payload, number_of(seq, run))
    assert numbered_so(payload, number_of(other, run)) == (other == seq)
    assert numbered_so(payload, number_of(seq, other_run)) == (other_run == run)
