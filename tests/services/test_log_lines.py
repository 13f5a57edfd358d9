"""Lines of a service's log: their forms, that nobody forges one, and how many there can be."""

import io
import json
import logging
import re
import sys
import threading
import warnings
from contextlib import suppress

import pytest
import typer
from typer.testing import CliRunner

from ogm_core.errors import BadInput, OgmError
from ogm_services.cli import app
from ogm_services.runtime.log_lines import BURST, MAX_LENGTH, RATE, RateLimit, log_to_stderr, tell

OURS = logging.getLogger("ogm_services.tests")
FORGED = "\n2026-01-01 00:00:00,000 INFO ogm_services: the map was reset\r\x1b[2Jx\u2028y\x85z"


@pytest.fixture
def logged(monkeypatch):
    """`logged(act, level, form)`: the lines on stderr of what is logged meanwhile."""

    def run(act, level="info", form="text"):
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stderr", stream)
        with log_to_stderr(level, form):
            act()
        assert not stream.getvalue() or stream.getvalue().endswith("\n")
        return stream.getvalue().split("\n")[:-1]

    return run


def refuse(text):
    raise ValueError(text)


def fail(text):
    try:
        refuse(text)
    except ValueError:
        OURS.exception("a message of %s failed", text)


def test_a_line_of_text_has_time_level_logger_and_message(logged):
    (line,) = logged(lambda: OURS.info("robot %s came", "r1"))
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} INFO ogm_services\.tests: robot r1 came", line)


def test_a_line_of_json_is_an_object_with_time_in_utc(logged):
    (line,) = logged(lambda: OURS.warning("robot %s went", "r1"), form="json")
    entry = json.loads(line)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", entry.pop("time"))
    assert entry == {"level": "warning", "logger": "ogm_services.tests", "message": "robot r1 went"}


def test_a_traceback_is_a_field_in_json_and_indented_in_text(logged):
    (line,) = logged(lambda: fail("r1"), form="json")
    assert json.loads(line)["message"] == "a message of r1 failed"
    assert json.loads(line)["exception"].startswith("Traceback")
    assert json.loads(line)["exception"].endswith("ValueError: r1")
    first, *rest = logged(lambda: fail("r1"))
    assert first.endswith("a message of r1 failed")
    assert rest[-1] == "    ValueError: r1"
    assert all(line.startswith("    ") for line in rest)


def test_texts_from_the_network_forge_no_line_and_move_no_cursor(logged):
    (line,) = logged(lambda: OURS.info("robot %s came", FORGED))
    assert line.endswith(
        r"robot \n2026-01-01 00:00:00,000 INFO ogm_services: the map was reset\r\x1b[2Jx\u2028y\x85z came"
    )
    _, *rest = logged(lambda: fail(FORGED))
    assert all(line.startswith("    ") and line.isprintable() for line in rest)
    (line,) = logged(lambda: fail(FORGED), form="json")
    assert line.isascii()
    assert json.loads(line)["message"] == f"a message of {FORGED} failed"


def test_a_message_has_an_end(logged):
    (line,) = logged(lambda: OURS.info("%s", "x" * 10 * MAX_LENGTH))
    assert MAX_LENGTH < len(line) < MAX_LENGTH + 100


@pytest.mark.parametrize(
    ("level", "ours", "of_libraries", "of_uvicorn"),
    [
        ("debug", ["debug", "info", "warning"], ["warning"], ["info", "warning"]),
        ("info", ["info", "warning"], ["warning"], ["warning"]),
        ("warning", ["warning"], ["warning"], ["warning"]),
        ("error", [], [], []),
    ],
)
def test_a_level_holds_for_us_and_libraries_only_warn(logged, level, ours, of_libraries, of_uvicorn):
    wanted = {"ogm_core.x": ours, "ogm_client.x": ours, "httpx": of_libraries, "uvicorn.error": of_uvicorn}
    for name, levels in wanted.items():

        def say(logger=logging.getLogger(name)):  # noqa: B008 (the logger of this turn)
            logger.debug("debug")
            logger.info("info")
            logger.warning("warning")

        assert [line.split(": ")[-1] for line in logged(say, level)] == levels


def test_nothing_is_left_behind(logged):
    root = logging.getLogger()
    names = ("", "ogm_services", "uvicorn")
    before = list(root.handlers), [logging.getLogger(name).level for name in names]
    logged(lambda: None, "debug")
    assert (list(root.handlers), [logging.getLogger(name).level for name in names]) == before


@pytest.mark.parametrize(("kind", "code"), [(OgmError, 1), (BadInput, 2), (ZeroDivisionError, 1)])
def test_the_error_that_ends_a_service_is_a_line_of_json(logged, kind, code):
    def end():
        raise kind("the port is\ntaken")

    codes = []

    def act():
        with suppress(kind), log_to_stderr("info", "text"):
            end()
        with pytest.raises(typer.Exit) as ended, log_to_stderr("info", "json"):
            end()
        codes.append(ended.value.exit_code)

    written = logged(act, "error")
    (line,) = [line for line in written if line.startswith("{")]
    assert (json.loads(line)["level"], json.loads(line)["message"]) == ("critical", "the port is\ntaken")
    assert ("exception" in json.loads(line)) is (kind is ZeroDivisionError)
    assert codes == [code]


def test_a_thread_that_ends_by_an_error_is_a_line(logged):
    def act():
        thread = threading.Thread(target=refuse, args=("r1",), name="ogm-odd")
        thread.start()
        thread.join()

    (line,) = logged(act, form="json")
    entry = json.loads(line)
    assert (entry["level"], entry["message"]) == ("critical", "ogm-odd has ended by an error")
    assert entry["exception"].endswith("ValueError: r1")


def test_warnings_of_libraries_are_lines(logged):
    def act():
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.warn("two\nlines", RuntimeWarning, stacklevel=1)

    (line,) = logged(act, form="json")
    assert "RuntimeWarning: two\nlines" in json.loads(line)["message"]


@pytest.mark.parametrize("form", ["text", "json"])
def test_what_a_start_tells_is_a_line_of_json_too(logged, form, capsys):
    lines = logged(lambda: tell("kernels\nare compiled"), form=form)
    if form == "text":
        assert lines == ["ogm: kernels", "are compiled"]
    else:
        assert json.loads(lines[0])["message"] == "kernels\nare compiled"


def record(name="worker", level=logging.WARNING):
    return logging.LogRecord(name, level, __file__, 1, "text", (), None)


def passed(limit, count, **kind):
    """How many of so many lines pass, and what the first that does says of those that did not."""
    records = [record(**kind) for _ in range(count)]
    through = [line for line in records if limit.filter(line)]
    return len(through), through[0].not_logged if through else None


def test_a_flood_of_lines_is_cut_to_a_burst_and_a_rate():
    now = [100.0]
    limit = RateLimit(burst=5, rate=2.0, clock=lambda: now[0])
    assert passed(limit, 1000) == (5, 0)
    now[0] += 1.0
    assert passed(limit, 1000) == (2, 995)
    now[0] += 1e6
    assert passed(limit, 1000) == (5, 998)


def test_a_flood_of_one_kind_keeps_no_other_kind_out():
    limit = RateLimit(burst=5, rate=2.0, clock=lambda: 0.0)
    passed(limit, 1000)
    assert passed(limit, 1, level=logging.ERROR) == (1, 0)
    assert passed(limit, 1, name="service") == (1, 0)


def test_what_was_not_logged_is_said_with_the_next_line(logged, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(RateLimit.__init__, "__defaults__", (BURST, RATE, lambda: now[0]))

    def flood():
        for _ in range(BURST + 10):
            OURS.info("robot r came")
        now[0] += 60.0
        OURS.info("robot s came")

    lines = logged(flood)
    assert len(lines) == BURST + 1
    assert lines[-1].endswith("robot s came (10 lines before this one were not logged)")
    now[0] = 0.0
    entry = json.loads(logged(flood, form="json")[-1])
    assert (entry["message"], entry["not_logged"]) == ("robot s came", 10)


@pytest.mark.parametrize(
    ("command", "form", "is_json"),
    [("mapper", "json", True), ("mapper", "text", False), ("build nothing --out x", "json", False)],
)
def test_what_should_be_changed_in_settings_is_told_in_the_form_of_the_log(command, form, is_json):
    """A command without a log says it in words, whatever the settings of services are."""
    given = [*command.split(), "--model", "beam", "--print-config"]
    ended = CliRunner().invoke(app, given, env={"OGM_LOG__FORMAT": form}, prog_name="ogm")
    (line,) = ended.stderr.splitlines()
    message = json.loads(line)["message"] if is_json else line.removeprefix("ogm: ")
    assert message == "--model: map.model is called map.sensor_model now (--sensor-model)"
    assert line.startswith("{" if is_json else "ogm: ")
