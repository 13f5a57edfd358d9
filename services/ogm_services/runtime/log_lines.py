"""Log of a service on stderr: one line an event, as text or as JSON, at a bounded rate.

Three things bound it, each another one. `RateLimit` bounds the whole log, whoever writes: so many lines of
each logger and level. `LimitedLog` bounds what is said of one source, so that one robot's nonsense keeps no
other robot's line out. The mapper's `Overload` counts dropped scans between its lines, to tell their rate.
"""

import json
import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import NamedTuple

import typer

from ogm_core.errors import OgmError
from ogm_services.runtime.endings import exit_code_of

OURS = ("ogm_core", "ogm_client", "ogm_services")
"""Loggers of the project; those of libraries tell of warnings only."""
BURST = 200
"""Lines of one logger and level that may come at once."""
RATE = 2.0
"""And how many a second after that: 35 MB a day of 200 bytes each."""
MAX_LENGTH = 4000
"""Characters of a message."""

log = logging.getLogger(__name__)


@contextmanager
def log_to_stderr(level: str, form: str) -> Iterator[None]:
    """Log what happens inside, from a level of debug, info, warning and error on, as `text` or as `json`.

    As JSON everything on stderr is a line of the log, an error that ends what runs inside, too, with the exit
    code that it has anyway.
    """
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonLine() if form == "json" else TextLine())
    handler.addFilter(RateLimit())
    wanted: int = getattr(logging, level.upper())
    of_libraries = max(wanted, logging.WARNING)
    levels = {"": of_libraries, **dict.fromkeys(OURS, wanted)}
    levels["uvicorn"] = logging.INFO if wanted < logging.INFO else of_libraries
    loggers = {name: logging.getLogger(name) for name in levels}
    before = {name: logger.level for name, logger in loggers.items()}
    for name, logger in loggers.items():
        logger.setLevel(levels[name])
    loggers[""].addHandler(handler)
    of_threads, threading.excepthook = threading.excepthook, _log_end_of_thread
    logging.captureWarnings(True)
    try:
        yield
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:
        if form != "json":
            raise
        expected = isinstance(error, OgmError)
        log.critical("%s", error, exc_info=None if expected else error)
        raise typer.Exit(exit_code_of(error)) from None
    finally:
        logging.captureWarnings(False)
        threading.excepthook = of_threads
        loggers[""].removeHandler(handler)
        for name, logger in loggers.items():
            logger.setLevel(before[name])


@contextmanager
def log_nothing() -> Iterator[None]:
    """What happens inside says at its end what there was to say."""
    silent, ours = logging.NullHandler(), logging.getLogger("ogm_services")
    ours.addHandler(silent)
    try:
        yield
    finally:
        ours.removeHandler(silent)


def tell(text: str) -> None:
    """Say something on stderr that whoever starts a command should know, whether it logs or not."""
    if any(isinstance(handler.formatter, JsonLine) for handler in logging.getLogger().handlers):
        log.warning("%s", text)
    else:
        typer.echo(f"ogm: {text}", err=True)


def _log_end_of_thread(ended: threading.ExceptHookArgs) -> None:
    name = ended.thread.name if ended.thread else "a thread"
    if ended.exc_value is not None:
        log.critical("%s has ended by an error", name, exc_info=ended.exc_value)


class RateLimit:
    """Filter of a handler: lets a burst of lines of each logger and level pass, then so many a second.

    The next line that passes says in its attribute `not_logged` how many did not. Kinds of lines are as many
    as the program has loggers, whoever sends what. `clock` tells s.
    """

    def __init__(
        self, burst: int = BURST, rate: float = RATE, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._burst = burst
        self._rate = rate
        self._clock = clock
        self._kinds: dict[tuple[str, int], _Left] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a line may pass; the handler's lock is not held, and an error in a count does no harm."""
        kind, now = (record.name, record.levelno), self._clock()
        left, at, passed_over = self._kinds.get(kind, _Left(self._burst, now, 0))
        left = min(float(self._burst), left + (now - at) * self._rate)
        passes = left >= 1.0
        self._kinds[kind] = _Left(left - 1.0, now, 0) if passes else _Left(left, now, passed_over + 1)
        record.not_logged = passed_over if passes else 0
        return passes


class _Left(NamedTuple):
    """Lines that may pass at a time, s, and how many have not."""

    lines: float
    at: float
    passed_over: int


class TextLine(logging.Formatter):
    """Local time, level, logger and message on one line; the lines of a traceback are indented.

    What is not printable is escaped: texts from the network cannot end a line and forge another.
    """

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record."""
        passed_over = getattr(record, "not_logged", 0)
        more = f" ({passed_over} lines before this one were not logged)" if passed_over else ""
        line = f"{self.formatTime(record)} {record.levelname} {record.name}: {_message(record)}{more}"
        trace = _trace(self, record)
        return "\n    ".join([printable(line), *map(printable, trace.splitlines())])


class JsonLine(logging.Formatter):
    """A JSON object on one line: time (ISO 8601, UTC), level, logger, message; exception and not_logged."""

    def format(self, record: logging.LogRecord) -> str:
        """The line of a record."""
        when = datetime.fromtimestamp(record.created, tz=UTC).isoformat(timespec="milliseconds")
        fields: dict[str, object] = {
            "time": when.replace("+00:00", "Z"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": _message(record),
        }
        if trace := _trace(self, record):
            fields["exception"] = trace
        if passed_over := getattr(record, "not_logged", 0):
            fields["not_logged"] = passed_over
        return json.dumps(fields)


def printable(text: str) -> str:
    """A text with every character escaped that ends a line, or that a terminal does not show as it is."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def _message(record: logging.LogRecord) -> str:
    text = record.getMessage()
    return text if len(text) <= MAX_LENGTH else f"{text[:MAX_LENGTH]}..."


def _trace(formatter: logging.Formatter, record: logging.LogRecord) -> str:
    """The traceback of a record's error; "" without one."""
    return "" if not record.exc_info else formatter.formatException(record.exc_info)
