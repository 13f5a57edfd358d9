"""Which world is the true one: told by simulators, read once, never mixed, forgotten with its map."""

import pytest

from ogm_core.simulation.catalogue import office
from ogm_core.simulation.worlds import dump_world, lab, load_world
from ogm_core.wire.keys import MAX_TRUTH_BYTES
from ogm_services.mapper.live import true_world as truth_module
from ogm_services.mapper.live.true_world import TrueWorld

LAB, OFFICE = (dump_world(world()).encode() for world in (lab, office))
BAD = [
    b"",
    b"\xff",
    b"[",
    b"{}",
    b"circles: [[0, 0, -1]]",
    b"image: map.pgm",
    b"a: &a [*a]",
    b"a: !!float " + b"1:" * 100_000 + b"1",
    b"a0: &a0 {x: 1}\n"
    + b"".join(b"a%d: &a%d {<<: [*a%d, *a%d]}\n" % (k, k, k - 1, k - 1) for k in range(1, 60)),
    b"a: " + b"[" * 200_000,
    b"walls: [[0, 0, 1e300, 1]]",
    b"x" * 3_000_000,
]


@pytest.fixture
def truth():
    return TrueWorld()


@pytest.fixture
def read(monkeypatch):
    """Every text that is read as a world."""
    texts = []

    def count(text):
        texts.append(text)
        return load_world(text)

    monkeypatch.setattr(truth_module, "load_world", count)
    return texts


def test_nobody_tells_a_world(truth):
    assert truth.world is None
    truth.heard("e", [])
    assert truth.world is None


def test_the_world_is_what_was_told(truth):
    truth.heard("e", [LAB])
    assert dump_world(truth.world).encode() == LAB
    truth.heard("e", [OFFICE])
    assert dump_world(truth.world).encode() == OFFICE
    truth.heard("e", [])
    assert truth.world is None


def test_what_is_told_again_is_not_read_again(truth, read):
    truth.heard("e", [LAB])
    first = truth.world
    for _ in range(3):
        truth.heard("e", [LAB, LAB])
        assert truth.world is first
    assert read == [LAB.decode()]


@pytest.mark.parametrize("text", BAD, ids=lambda text: repr(text[:20]))
def test_what_is_no_world_is_passed_over_with_one_line(truth, caplog, text):
    for _ in range(5):
        truth.heard("e", [text])
        assert truth.world is None
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert "\n" not in record.getMessage()
    assert "a simulator's world: passed over: " in record.getMessage()
    truth.heard("e", [LAB])
    assert truth.world is not None


def test_nonsense_that_changes_all_the_time_does_not_fill_the_log(truth, caplog):
    for k in range(100):
        truth.heard("e", [b"%d" % k])
    assert len(caplog.records) < 5


class Payload:
    """Bytes of somebody else: only their length is known until they are copied."""

    def __init__(self, length):
        self._length = length

    def __len__(self):
        return self._length

    def __bytes__(self):
        raise AssertionError("they are copied")


def test_what_is_too_long_is_not_even_copied(truth, caplog):
    truth.heard("e", [Payload(2**30), LAB])
    assert dump_world(truth.world).encode() == LAB
    assert "passed over: its 1073741824 bytes are more than 262144" in caplog.text


def test_what_is_no_world_is_not_read_again_when_others_change(truth, read):
    for other in (LAB, OFFICE, LAB):
        truth.heard("e", [b"{}", other])
    assert read.count("{}") == 1


def test_the_log_repeats_no_name_without_end(truth, caplog):
    texts = [LAB.replace(b"name: lab", b"name: " + letter * 100_000) for letter in (b"a", b"b")]
    truth.heard("e", texts)
    assert f"simulators: they tell 2 worlds; '{'a' * 64}' counts" in caplog.text


def test_what_is_heard_after_the_end_does_not_count(truth):
    truth.heard("e", [LAB])
    truth.settle()
    truth.heard("e", [OFFICE])
    assert truth.world.name == "lab"


def test_what_is_too_long_is_not_even_read(truth, read, caplog):
    assert MAX_TRUTH_BYTES == 256 * 1024
    truth.heard("e", [LAB + b"#" * (MAX_TRUTH_BYTES - len(LAB))])
    assert truth.world is not None
    truth.heard("e", [LAB + b"#" * (MAX_TRUTH_BYTES + 1 - len(LAB))])
    assert truth.world is None
    assert len(read) == 1
    said = f"passed over: its {MAX_TRUTH_BYTES + 1} bytes are more than {MAX_TRUTH_BYTES}; the map's quality"
    assert f"{said} has no `truth`" in caplog.text


@pytest.mark.parametrize("told", [[LAB, OFFICE], [OFFICE, LAB], [b"", OFFICE, LAB], [LAB, b"", OFFICE, LAB]])
def test_of_two_worlds_one_counts_whoever_answers_first(truth, read, told, caplog):
    truth.heard("e", told)
    assert dump_world(truth.world).encode() == min(LAB, OFFICE)
    assert "simulators: they tell 2 worlds; 'lab' counts" in caplog.text
    first = truth.world
    truth.heard("e", told[::-1])
    assert truth.world is first
    assert len(read) == len(set(told))
    truth.heard("e", [max(LAB, OFFICE)])
    assert dump_world(truth.world).encode() == max(LAB, OFFICE)


def test_at_the_end_the_last_world_of_this_map_stays(truth):
    truth.heard("e", [OFFICE])
    truth.heard("e", [LAB])
    truth.heard("e", [])
    assert truth.world is None
    truth.settle()
    assert dump_world(truth.world).encode() == LAB


def test_the_world_of_the_map_before_a_reset_does_not_stay(truth):
    truth.heard("e", [LAB])
    truth.heard("other", [])
    truth.settle()
    assert truth.world is None
