import signal
import subprocess
import sys

import pytest
import typer

from ogm_services.runtime.signals import held_signals, running_service

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.fixture(autouse=True)
def handlers():
    """Handlers as a shell leaves them, whatever has started these tests."""
    kept = {number: signal.getsignal(number) for number in ENDING}
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield {**kept, signal.SIGHUP: signal.SIG_DFL}
    for number, handler in kept.items():
        signal.signal(number, handler)


def ended(serve, **options):
    """Exit code with which a signal ends a service."""
    with pytest.raises(typer.Exit) as end, running_service(**options):
        serve()
    return end.value.exit_code


@pytest.mark.parametrize("number", ENDING)
def test_a_signal_ends_a_service_and_the_next_ones_do_nothing(number):
    reached = []

    def serve():
        try:
            signal.raise_signal(number)
            reached.append("after the signal")
        finally:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
            signal.raise_signal(signal.SIGHUP)
            reached.append("stopped in order")

    assert ended(serve, interrupted=7) == 7
    signal.raise_signal(signal.SIGTERM)
    assert reached == ["stopped in order"]


def test_a_service_that_ends_by_itself_leaves_the_handlers_as_they_were(handlers):
    with running_service():
        for number in ENDING:
            assert signal.getsignal(number) is not handlers[number]
    assert {number: signal.getsignal(number) for number in handlers} == handlers


@pytest.mark.parametrize("number", ENDING)
def test_held_signals_come_when_what_runs_inside_is_done(number):
    reached = []

    def serve():
        with held_signals():
            signal.raise_signal(number)
            reached.append("inside")
        reached.append("after")

    assert ended(serve) == 0
    assert reached == ["inside"]


def test_nothing_held_nothing_raised(handlers):
    with held_signals():
        pass
    assert {number: signal.getsignal(number) for number in handlers} == handlers


def test_under_nohup_a_closed_terminal_ends_nothing_and_hides_no_other_signal():
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    reached = []

    def serve():
        signal.raise_signal(signal.SIGHUP)
        reached.append("after the first")
        with held_signals():
            signal.raise_signal(signal.SIGHUP)
            signal.raise_signal(signal.SIGTERM)
        reached.append("never")

    assert ended(serve, interrupted=7) == 7
    assert reached == ["after the first"]
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_ctrl_c_before_anything_runs_ends_it_without_a_word():
    program = """
import os, signal, sys
class Interrupt:
    def find_spec(self, name, *_):
        if name == "ogm_services.cli":
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Interrupt())
from ogm_services.__main__ import main
main()
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGINT, "", "")
