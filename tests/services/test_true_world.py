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
    b"a: " + b"[" * 200_000,
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


def test_what_is_too_long_is_not_even_read(truth, read, caplog):
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
