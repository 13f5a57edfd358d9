"""Any JSON as a status: values that can be shown come out of it, or a BadReply in one line."""

import json
from dataclasses import is_dataclass

from hypothesis import given
from hypothesis import strategies as st

from mutations import SEEDS, mutated
from ogm_client.errors import BadReply
from ogm_client.status_reply import read_status
from ogm_client.transport import mapper_error
from ogm_core.status import encode_status
from status_json import STATUS

SENT = encode_status(STATUS)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=10),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)


def leaves(value):
    if is_dataclass(value):
        value = {name: getattr(value, name) for name in value.__dataclass_fields__}
    if isinstance(value, dict):
        return [*value, *(leaf for part in value.values() for leaf in leaves(part))]
    if isinstance(value, list | tuple):
        return [leaf for part in value for leaf in leaves(part)]
    return [value]


def check(payload):
    try:
        status = read_status(payload)
    except BadReply as error:
        text = str(error)
    else:
        assert all(leaf.isprintable() for leaf in leaves(status) if isinstance(leaf, str))
        numbers = [leaf for leaf in leaves(status) if isinstance(leaf, int | float)]
        assert all(-(2**64) < number < 2**64 for number in numbers)
        return
    assert text.isprintable()
    assert len(text) < 700


@given(SEEDS)
def test_a_damaged_status(rng):
    check(mutated(rng, SENT))


@given(st.dictionaries(st.sampled_from(sorted(json.loads(SENT))), VALUES, max_size=3))
def test_any_values_in_a_status(changes):
    check(json.dumps(json.loads(SENT) | changes).encode())


@given(st.binary(max_size=100) | VALUES.map(lambda value: json.dumps(value).encode()))
def test_any_refusal(payload):
    try:
        text = str(mapper_error("/status", payload))
    except BadReply as error:
        text = str(error)
    assert text.isprintable()
    assert len(text) < 700
