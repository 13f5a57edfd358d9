"""Robots that are resumed together: none gets ahead of another that is on its way, and none waits in vain."""

import threading

import pytest

from ogm_services.mapper.intake import in_step as in_step_module
from ogm_services.mapper.intake.in_step import AHEAD_NS, InStep


@pytest.fixture
def patient(monkeypatch):
    """Nobody loses patience."""
    monkeypatch.setattr(in_step_module, "PATIENCE", 600.0)
    monkeypatch.setattr(in_step_module, "EXPECTED", 600.0)


@pytest.fixture
def turn(in_background):
    """`turn(steps, robot, stamp)`: a thread that waits for a message's turn; all end with the test."""
    stopping = threading.Event()
    yield lambda steps, robot, stamp: in_background(steps.wait, robot, stamp, stopping)
    stopping.set()


def test_a_robot_waits_for_one_that_is_behind_by_more_than_it_may_be_ahead(patient, turn):
    steps = InStep()
    steps.begin("a")
    steps.begin("b")
    ahead = turn(steps, "a", AHEAD_NS + 1)
    turn(steps, "b", 0).result(60.0)
    assert not ahead.done()
    turn(steps, "b", 1).result(60.0)
    ahead.result(60.0)


def test_it_waits_for_one_of_which_nobody_knows_how_far_it_is(patient, turn):
    steps = InStep()
    steps.begin("a")
    steps.begin("b")
    first = turn(steps, "a", 0)
    assert not first.done()
    steps.end("b")
    first.result(60.0)


def test_expected_robots_are_waited_for_from_the_start_on_until_they_come(patient, turn):
    steps = InStep(["b"])
    steps.begin("a")
    turn(steps, "a", 0).result(60.0)
    steps.started()
    first = turn(steps, "a", 1)
    assert not first.done()
    steps.begin("b")
    assert not first.done()
    turn(steps, "b", 0).result(60.0)
    first.result(60.0)


def test_one_that_gets_no_farther_is_not_waited_for_in_the_end(monkeypatch, turn):
    monkeypatch.setattr(in_step_module, "PATIENCE", 0.05)
    monkeypatch.setattr(in_step_module, "EXPECTED", 0.05)
    steps = InStep(["c"])
    steps.started()
    steps.begin("a")
    steps.begin("b")
    turn(steps, "a", 10**12).result(60.0)


def test_nobody_waits_any_more_once_all_is_stopping(patient, in_background):
    steps, stopping = InStep(), threading.Event()
    steps.begin("a")
    steps.begin("b")
    first = in_background(steps.wait, "a", 0, stopping)
    assert not first.done()
    stopping.set()
    first.result(60.0)
