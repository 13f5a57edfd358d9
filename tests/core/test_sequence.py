"""Seqs that were seen, as spans: the same as a set of numbers, and what was told of them stays as it was."""

import random

import pytest

from ogm_core.placing.held import Held
from ogm_core.placing.runs import MAX_RUNS, Runs
from ogm_core.placing.sequence import MAX_STEP, SPAN_BYTES, Sequence


def bytes_of(state):
    """The state as who has read it from bytes has it."""
    taken, last, starts, ends, strays = state
    return taken, last, starts.tobytes(), ends.tobytes(), list(strays)


@pytest.mark.parametrize("seed", range(6))
def test_it_is_a_set_of_numbers(seed):
    rng, seqs, seen, told = random.Random(seed), Sequence(held := Held()), set(), []
    last = None
    for _ in range(600):
        first = rng.randrange(120)
        if rng.random() < 0.6:
            if not seqs.extend(first):
                seqs.note(first)
            seen.add(first)
            last = first if last is None else max(last, first)
        else:
            until = first + rng.choice([0, 0, 1, 5])
            seqs.skip(first, until)
            seen |= set(range(first, until + 1))
        assert seqs.last == last
        assert {n for n in range(130) if n in seqs} == seen
        start, end = seqs.first_span
        assert start == min(seen)
        assert end == next(n for n in range(start, 200) if n not in seen) - 1
        assert held.nbytes == seqs.nbytes
        if rng.random() < 0.1:
            told.append((seqs.state(), bytes_of(seqs.state()), set(seen)))
        if rng.random() < 0.02:  # the numbering goes on from its state, in another life
            state = seqs.state()
            seqs = Sequence(held := Held())
            seqs.restore(bytes_of(state))
    for state, kept, then in told:
        assert bytes_of(state) == kept
        again = Sequence()
        again.restore(kept)
        assert {n for n in range(130) if n in again} == then
    assert held.nbytes % SPAN_BYTES == 0


def test_what_is_skipped_is_nothing_that_came():
    seqs = Sequence()
    seqs.skip(3, 9)
    assert (seqs.last, seqs.is_above(1), seqs.taken, 5 in seqs) == (None, True, False, True)
    seqs.note(4)
    seqs.skip(4 + MAX_STEP, 5 + MAX_STEP)  # nobody sends such a one after this one
    assert (seqs.last, seqs.first_span) == (4, (3, 9))


def test_strays_go_with_the_state():
    seqs, again = Sequence(), Sequence()
    for seq in (1, 2, *(10**9 + k for k in range(3))):
        seqs.note(seq)
    again.restore(bytes_of(seqs.state()))
    for which in (seqs, again):
        which.note(10**9 + 3)
        assert which.last == 2
        which.note(10**9 + 4)
        assert (which.last, which.first_span) == (10**9 + 4, (10**9, 10**9 + 4))


def test_a_run_is_one_of_which_something_was_taken():
    runs = Runs()
    runs.skip("a", 0, 4)
    assert runs.of("a") is None
    assert runs.seen("a", 4)
    runs.note("a", 5)
    assert runs.of("a").last == 5
    runs.note("", 7)
    assert runs.of("") is not None
    assert not runs.seen("", 7)
    runs.skip("", 0, 9)
    assert not runs.has("", 7)


def test_the_run_heard_longest_ago_is_forgotten_in_another_life_too():
    runs = Runs(held := Held())
    for n in range(MAX_RUNS):
        runs.note(f"run{n}", 3)
    runs.note("run0", 4)
    heard, told = runs.state()
    again = Runs(anew := Held())
    again.restore([heard, [(run, bytes_of(state)) for run, state in told]])
    assert anew.nbytes == held.nbytes
    for which in (runs, again):
        which.note("run0", 5)
        which.note("new", 0)
        assert which.of("run1") is None
        assert (which.of("run0").last, which.of("run2").last) == (5, 3)
