import signal

import pytest
import typer

from ogm_services.runtime.signals import held_signals, running_service


@pytest.fixture(autouse=True)
def handlers():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield before
    for number, handler in before.items():
        signal.signal(number, handler)


def ended(serve, **options):
    """Exit code with which a signal ends a service."""
    with pytest.raises(typer.Exit) as end, running_service(**options):
        serve()
    return end.value.exit_code


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_service_and_the_next_ones_do_nothing(number):
    reached = []

    def serve():
        try:
            signal.raise_signal(number)
            reached.append("after the signal")
        finally:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
            reached.append("stopped in order")

    assert ended(serve, interrupted=7) == 7
    signal.raise_signal(signal.SIGTERM)
    assert reached == ["stopped in order"]


def test_a_service_that_ends_by_itself_leaves_the_handlers_as_they_were(handlers):
    with running_service():
        assert signal.getsignal(signal.SIGTERM) is not handlers[signal.SIGTERM]
    assert {number: signal.getsignal(number) for number in handlers} == handlers


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
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
