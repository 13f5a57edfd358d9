"""`ogm status --watch`: rates, and mappers that go and come back."""

import dataclasses
import io
import json
from contextlib import contextmanager

import pytest
from rich.console import Console
from typer.testing import CliRunner

from ogm_client.errors import CannotConnect, MapperError, NobodyAnswered
from ogm_core.errors import BadInput, BadSetting
from ogm_core.status import RobotStatus, ScanCounts, SourceStatus, encode_status
from ogm_services.cli import app
from ogm_services.commands import status_watch
from ogm_services.commands.status import Rates
from ogm_services.commands.status_watch import check_period, rates_between, watch
from status_json import STATUS

NOWHERE = "no mapper answers at tcp/there:7447, trying again"


def status(received, integrated, dropped, uptime):
    counts = ScanCounts(
        received, integrated, received - integrated - dropped, {"no_pose": dropped, "limit": 0}
    )
    return dataclasses.replace(STATUS, scans=counts, uptime_s=uptime)


def test_rates_are_what_was_gained_by_the_mappers_own_clock():
    assert rates_between(status(100, 90, 4, 10.0), status(150, 120, 14, 12.5)) == Rates(
        20.0, 12.0, 4.0, {"r2/front": 0.0}
    )


def of_sensors(uptime, **received):
    """A status of robot r, of which each sensor has sent so many scans."""
    sources = {sensor: SourceStatus("a", 1, count, 0, count) for sensor, count in received.items()}
    robots = {"r": RobotStatus(None, None, alive=True, sources=sources)}
    return dataclasses.replace(status(sum(received.values()), 0, 0, uptime), robots=robots)


BEFORE, AFTER = (
    of_sensors(10.0, front=100, back=7, side=50),
    of_sensors(12.0, front=180, back=7, side=3, new=5),
)


def test_each_sensor_has_a_rate_but_one_that_is_counted_from_the_start_again():
    assert rates_between(BEFORE, AFTER).sources == {"r/front": 40.0, "r/back": 0.0, "r/new": 2.5}


def test_the_rate_of_each_sensor_stands_beside_what_it_has_sent(seen):
    first, second = seen([BEFORE, AFTER]).out.split("map hall")[1:]
    table = [line.split() for line in second.splitlines() if "r/" in line or "last seq" in line]
    assert "received   a second   integrated" in second
    assert [line[:3] for line in table[1:]] == [
        ["r/back", "7", "0.0"],
        ["r/front", "180", "40.0"],
        ["r/new", "5", "2.5"],
        ["r/side", "3", "3"],
    ]
    assert "a second" not in first


@pytest.mark.parametrize("before", [None, status(10, 9, 0, 50.0), status(200, 9, 0, 1.0)])
def test_a_new_mapper_has_no_rates_yet(before):
    assert rates_between(before, status(150, 120, 14, 12.5)) is None


@pytest.fixture
def seen(monkeypatch, capsys):
    """`seen(looks, as_json)`: what is printed while looks end so: a status, or an error that is raised."""

    def run(looks, *, as_json=False):
        looks, slept = iter(looks), []

        class Client:
            def fetch(self, name):
                assert name == "status"
                look = next(looks, KeyboardInterrupt)
                if not isinstance(look, type(STATUS)):
                    raise look
                return encode_status(look)

        @contextmanager
        def connect():
            yield Client()

        monkeypatch.setattr(status_watch.time, "sleep", slept.append)
        with pytest.raises(KeyboardInterrupt):
            watch(connect, "tcp/there:7447", 2.0, as_json=as_json)
        assert all(0.0 <= pause <= 2.0 for pause in slept)
        return capsys.readouterr()

    return run


AWAY = [CannotConnect("no"), NobodyAnswered("no"), CannotConnect("no")]


def test_a_line_of_json_for_each_look_and_one_word_when_nobody_answers(seen):
    looks = [status(1, 1, 0, 1.0), status(2, 2, 0, 2.0), *AWAY, status(0, 0, 0, 0.1), *AWAY]
    printed = seen(looks, as_json=True)
    received = [json.loads(line)["scans"]["received"] for line in printed.out.splitlines()]
    assert received == [1, 2, 0]
    assert printed.err == f"ogm: {NOWHERE}\n" * 2


def test_without_a_terminal_one_table_follows_the_other(seen):
    printed = seen([status(100, 90, 4, 10.0), status(150, 120, 14, 12.5), *AWAY])
    first, second = printed.out.split("map hall")[1:]
    assert "a second" not in first
    assert "a second   20.0 received, 12.0 integrated, 4.0 dropped" in second
    assert second.count(NOWHERE) == 3
    assert printed.err == ""


def test_on_a_terminal_the_table_stays_in_its_place(seen, monkeypatch):
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=100, height=60)
    monkeypatch.setattr(status_watch, "Console", lambda: console)
    seen([status(100, 90, 4, 10.0), status(150, 120, 14, 12.5), *AWAY])
    drawn = screen.getvalue()
    assert "\x1b[1A\x1b[2K" in drawn  # up, and that line emptied
    assert "20.0 received, 12.0 integrated, 4.0 dropped" in drawn.split(NOWHERE)[-2]


def test_what_a_mapper_says_that_does_not_answer_is_said(seen):
    printed = seen([MapperError("starting", 503, "ask again"), status(1, 1, 0, 1.0)], as_json=True)
    assert printed.err == "ogm: the mapper refused: ask again (starting, 503), trying again\n"


def test_an_address_that_can_never_be_one_ends_it():
    def connect():
        raise BadSetting("url: no")

    with pytest.raises(BadSetting):
        watch(connect, "?", 2.0, as_json=True)


@pytest.mark.parametrize("period", [0.0, -1.0, 0.09, float("inf"), float("nan")])
def test_a_period_is_a_time(period):
    with pytest.raises(BadInput, match=r"--watch: 0\.1 s or more are needed"):
        check_period(period)


def test_a_period_is_two_seconds_if_none_is_given():
    assert check_period(None) == 2.0
    assert check_period(0.1) == 0.1


def test_a_period_without_watch_is_refused():
    ended = CliRunner().invoke(app, ["status", "5"], prog_name="ogm")
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert ended.stderr == "ogm: 5: a time between two looks needs --watch\n"
