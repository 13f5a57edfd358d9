"""Numbers of a source's messages: what is next, what is missing, and where a numbering begins anew."""

import pytest

from ogm_core.types import Pose, PoseStamped
from ogm_core.wire.messages import encode_pose
from ogm_services.mapper.intake.numbering import MAX_RUNS, Numbering, Standing

NEXT, BEGINNING, GAP, OLD, STRAY = Standing


def numbering(**decided):
    """A source of which so much of each run was decided in an earlier life."""
    return Numbering(decided.get)


def taken(source, *seqs, run="a"):
    """Hand on messages; the ranges that are given up by that."""
    return [list(source.take(run, seq)) for seq in seqs]


def test_seqs_that_follow_one_another_are_next():
    source = numbering()
    for seq in range(5):
        assert source.standing("a", seq) is NEXT
        assert taken(source, seq) == [[]]
    assert source.last("a") == 4


def test_a_seq_after_the_next_is_a_gap_and_what_is_missing_is_given_up_with_it():
    source = numbering()
    taken(source, 0)
    assert source.standing("a", 3) is GAP
    assert taken(source, 3, 4, 9) == [[1, 2], [], [5, 6, 7, 8]]
    assert [source.standing("a", seq) for seq in (2, 9, 10, 11)] == [OLD, OLD, NEXT, GAP]


def test_the_first_message_of_a_run_is_the_beginning_unless_its_seq_is_0():
    source = numbering()
    assert source.standing("a", 7) is BEGINNING
    assert taken(source, 7) == [[]]
    assert source.standing("b", 0) is NEXT
    assert (source.last("a"), source.last("b")) == (7, None)


def test_what_was_decided_in_an_earlier_life_comes_before():
    source = numbering(a=41)
    assert [source.standing("a", seq) for seq in (0, 41, 42, 43)] == [OLD, OLD, NEXT, GAP]
    assert taken(source, 44) == [[42, 43]]
    assert source.standing("b", 42) is BEGINNING


def test_a_run_without_a_name_numbers_nothing():
    source = numbering()
    for seq in (5, 0, 0, 99, 3):
        assert source.standing("", seq) is NEXT
        assert taken(source, seq, run="") == [[]]


def test_a_seq_far_above_the_last_is_no_gap_and_five_rising_ones_begin_the_numbering_there():
    source, far = numbering(), 1_000_000
    taken(source, 0)
    assert source.standing("a", far) is GAP
    assert source.standing("a", far + 1) is STRAY
    assert taken(source, far + 1, far + 2, far + 3, far + 4) == [[]] * 4
    assert [source.standing("a", seq) for seq in (1, 2, far + 5)] == [NEXT, GAP, STRAY]
    taken(source, far + 5)
    assert [source.standing("a", seq) for seq in (1, far + 5, far + 6)] == [OLD, OLD, NEXT]


@pytest.mark.parametrize("between", [1, 2_000_000])
def test_strays_that_do_not_rise_in_a_row_begin_nothing(between):
    """One of the source's own numbers, or a smaller stray, comes in between."""
    source, far = numbering(), 3_000_000
    taken(source, 0, *range(far, far + 4), between, far + 4)
    assert source.standing("a", far + 5) is STRAY
    assert source.last("a") == (1 if between == 1 else 0)


def test_messages_that_nobody_could_read_are_some_of_the_missing():
    source = numbering()
    taken(source, 0)
    source.unread = 2
    assert source.standing("a", 4) is GAP
    assert source.standing("a", 3) is NEXT
    assert taken(source, 3) == [[]]
    assert source.standing("a", 5) is GAP


def test_a_message_out_of_a_cache_is_known_when_it_comes_by_itself():
    source = numbering()
    for seq in range(4):
        source.take("a", seq, twin=100 + seq)
    assert source.is_twin("a", 2, 102)
    assert not source.is_twin("a", 2, 103)
    assert not source.is_twin("b", 2, 102)
    taken(source, 4)  # those before it cannot come any more
    assert not source.is_twin("a", 2, 102)


def test_the_run_that_was_heard_longest_ago_is_forgotten():
    source = numbering(run0=3)
    for k in range(MAX_RUNS):
        source.take(f"run{k}", 10)
    assert source.last("run0") == 10
    source.take("new", 0)
    source.take("other", 0)
    assert source.last("run1") is None
    assert source.last("run0") == 10


def test_the_next_message_is_told_at_a_glance():
    """Only after one that came by itself, of that run, and only the next one."""
    source = numbering()
    assert not source.take_next(pose(0))
    taken(source, 0)
    source.unread = 1
    assert source.take_next(pose(1))
    assert source.unread == 0
    assert not source.take_next(pose(3))
    assert not source.take_next(pose(2, run="b"))
    assert not source.take_next(b"bad")
    assert [source.take_next(pose(seq)) for seq in range(2, 70_000)] == [True] * 69_998
    assert source.last("a") == 69_999
    source.take("a", 70_000, twin=5)
    assert not source.take_next(pose(70_001))  # it may be a twin
    assert taken(source, 2_000_000, 70_001) == [[], []]
    assert source.take_next(pose(70_002))
    taken(source, 5_000_000)
    assert not source.take_next(pose(70_003))  # five strays in a row would no longer be in a row
    assert source.standing("b", 3) is BEGINNING
    assert not source.take_next(pose(70_003))


def pose(seq, run="a"):
    return encode_pose(PoseStamped(2**60, Pose(0.0, 0.0, 0.0), seq, run))
