"""`ogm` commands as processes of their own: started with pipes, waited for with deadlines, always reaped.

And in this process, where another one would show no more: each takes a second to start.
"""

import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import ExitStack, chdir, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from ogm_services.cli import app
from ogm_services.runtime.kernel_cache import begins_empty
from ogm_services.settings.sources import without_settings
from room import lines

STARTED = 120.0
"""How long a command may take to start, s: on a fresh checkout it compiles its kernels."""
STOPPED = 30.0
"""How long a service may take to end after SIGTERM or Ctrl-C, s."""
ABORTED = 5.0
"""How long one that did not end may take to say where its threads stand, s."""


@dataclass(frozen=True)
class Ended:
    """How a command ended: exit code, what it printed, and how long it ran, s."""

    code: int
    out: str
    err: str
    seconds: float

    @property
    def warnings(self):
        """What stands on stderr besides the log's lines of what goes well."""
        lines = self.err.splitlines(keepends=True)
        return "".join(line for line in lines if not re.match(r"[-\d]+ [:,\d]+ INFO ogm_", line))

    def complaint(self, code):
        """The one warning on stderr of a command that ended with `code`; nothing was printed on stdout."""
        assert (self.code, self.out) == (code, ""), self
        assert re.fullmatch(r"ogm: [^\n]+\n", self.warnings), self
        return self.warnings


@contextmanager
def _hang_ups_heard():
    """Inside, processes are started that heed SIGHUP, though these tests may run under nohup."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)


class Command:
    """A running `ogm` command, leader of a process group of its own.

    Threads read its pipes to their end, so that it never waits for us.
    """

    def __init__(self, *args, cwd, **environ):
        self._start = time.monotonic()
        with _hang_ups_heard():
            self.process = subprocess.Popen(
                [sys.executable, "-m", "ogm_services", *map(str, args)],
                cwd=cwd,
                env={**without_settings(os.environ), "PYTHONFAULTHANDLER": "1", **environ},
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,
            )
        self.args = args
        self._ended = None
        self._out, self._err = [], []
        self._readers = [
            threading.Thread(target=_read, args=pipe)
            for pipe in ((self.process.stdout, self._out), (self.process.stderr, self._err))
        ]
        for reader in self._readers:
            reader.start()

    def line(self, pattern, timeout=STARTED):
        """The match of a line on stdout; fails at once if the command ends without it."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            running = self.process.poll() is None
            for line in list(self._out):
                if match := re.match(pattern, line):
                    return match
            assert running, f"{self.args} ended without {pattern!r}: {self.wait()}"
            time.sleep(0.01)
        pytest.fail(f"{self.args}: {pattern!r} was not printed within {timeout} s: {self._out}{self._err}")

    def complains(self, text, timeout=STARTED):
        """Wait until a text stands on stderr; fails at once if the command ends without it."""
        deadline = time.monotonic() + timeout
        while text not in "".join(list(self._err)):
            assert self.process.poll() is None, f"{self.args} ended without {text!r}: {self.wait()}"
            assert time.monotonic() < deadline, f"{self.args}: {self._out}{self._err}"
            time.sleep(0.01)

    def wait(self, timeout=STARTED):
        """Wait for the command's end, and that of everything that it started; how it ended."""
        if self._ended is None:
            self._ended = self._wait(timeout)
        return self._ended

    def _wait(self, timeout):
        try:
            code = self.process.wait(timeout)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGABRT)  # it says where each of its threads stands
            self._readers[1].join(ABORTED)
            stands = f"{self._out}{''.join(self._err)}"
            pytest.fail(f"{self.args} did not end within {timeout} s: {stands}")
        seconds = time.monotonic() - self._start
        for reader in self._readers:
            reader.join(timeout)
            assert not reader.is_alive(), f"{self.args} left a process behind that holds its pipes"
        assert not self.group_lives(), f"{self.args} left a process behind"
        return Ended(code, "".join(self._out), "".join(self._err), seconds)

    def stop(self, number=signal.SIGTERM, *, group=False, within=STOPPED):
        """Send a signal, to the process or to its whole group as a terminal does; wait for the end."""
        if group:
            os.killpg(self.process.pid, number)
        else:
            self.process.send_signal(number)
        return self.wait(within)

    def processes(self):
        """Command lines of the group's processes, by process id."""
        found = {}
        for entry in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):  # it has ended meanwhile
                if os.getpgid(int(entry.name)) == self.process.pid:
                    found[int(entry.name)] = (entry / "cmdline").read_text().split("\0")
        return found

    def kill_child(self, word):
        """Kill -9 the one process of the group, other than the leader, whose command line has a word."""
        children = [
            pid for pid, words in self.processes().items() if word in words and pid != self.process.pid
        ]
        (pid,) = children
        os.kill(pid, signal.SIGKILL)

    def kill(self):
        """End the command and all that it started, by force."""
        if self._ended is not None:
            return  # its number may be another's by now
        with suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        for reader in self._readers:
            reader.join()

    def group_lives(self):
        """Whether any process of the group is left; the group's number is not used again while one is."""
        try:
            os.killpg(self.process.pid, 0)
        except ProcessLookupError:
            return False
        return True


def _read(pipe, lines):
    with pipe:
        lines.extend(pipe)


class Mapper:
    """A running `ogm mapper` (or `ogm demo`) that was ready, and what it serves over HTTP."""

    def __init__(self, command):
        self.command = command
        self.url = command.line(r"live map (http://\S+/)")[1]
        self.endpoint = command.line(r"map .* on Zenoh at (\S+)$")[1]

    def get(self, path):
        """Body of a route."""
        with urllib.request.urlopen(self.url + path, timeout=30) as response:
            return response.read()

    def status(self):
        """What /status says; the books balance at every moment."""
        status = json.loads(self.get("status"))
        scans = status["scans"]
        dropped = sum(scans["dropped"].values())
        assert scans["received"] == scans["integrated"] + scans["pending"] + dropped
        return status

    def map(self):
        """Arrays of /map.npz by name."""
        return arrays(self.get("map.npz"))


class Ogm:
    """Starts `ogm` commands in one folder, without settings in their environment but those given."""

    def __init__(self, folder):
        self.folder = folder
        self._commands = []

    def start(self, *args, **environ):
        """Start a command."""
        command = Command(*args, cwd=self.folder, **environ)
        self._commands.append(command)
        return command

    def run(self, *args, timeout=STARTED, **environ):
        """Run a command to its end."""
        return self.start(*args, **environ).wait(timeout)

    def call(self, *args, **environ):
        """Run a command to its end in this process, as if in the folder."""
        unset = dict.fromkeys(os.environ.keys() - without_settings(os.environ).keys())
        began = time.monotonic()
        with chdir(self.folder):
            ended = CliRunner().invoke(
                app, [*map(str, args)], prog_name="ogm", env={**unset, **environ}, catch_exceptions=False
            )
        return Ended(ended.exit_code, ended.stdout, ended.stderr, time.monotonic() - began)

    def mapper(self, *flags, **environ):
        """Start a mapper on free ports; `ready(command)` waits for it."""
        return self.start("mapper", "--http-port", "0", "--listen", "tcp/127.0.0.1:0", *flags, **environ)

    def ready(self, command):
        """Wait until a mapper is ready."""
        return Mapper(command)

    def file(self, name, text):
        """Write a file into the commands' folder."""
        (self.folder / name).write_text(text)

    def map(self, name):
        """Arrays by name of a map.npz that a command wrote."""
        return arrays((self.folder / name).read_bytes())

    def close(self):
        """End what still runs: every service ends well when told, whatever the test did with it."""
        running = [command for command in self._commands if command.process.poll() is None]
        try:
            for command in running:
                command.process.terminate()
            ended = [command.wait(STOPPED) for command in running]
            assert all(end.code == 0 for end in ended), ended
        finally:
            for command in self._commands:
                command.kill()
        for command in self._commands:
            assert "Traceback" not in command.wait().err, command.wait().err


@pytest.fixture(scope="session", autouse=True)
def _compiled_kernels(tmp_path_factory):
    """A first start speaks of the compiler on stderr: here it is over before the tests look at theirs."""
    if begins_empty():
        started = Ogm(tmp_path_factory.mktemp("first"))
        try:
            started.ready(started.mapper())
        finally:
            started.close()


@pytest.fixture
def ogm(tmp_path):
    """Starts `ogm` commands in a folder of the test's own; whatever still runs at its end is stopped."""
    started = Ogm(tmp_path)
    yield started
    started.close()


@pytest.fixture(scope="module")
def module_ogm(tmp_path_factory):
    """The same for all tests of a module together."""
    started = Ogm(tmp_path_factory.mktemp("ogm"))
    yield started
    started.close()


@pytest.fixture(scope="module")
def ogm_in():
    """`ogm_in(folder)`: starts commands in a folder that the module's tests share."""
    with ExitStack() as ending:

        def start_in(folder):
            started = Ogm(folder)
            ending.callback(started.close)
            return started

        yield start_in


@pytest.fixture(scope="module")
def idle_mapper(module_ogm):
    """A mapper for tests that send it nothing."""
    return module_ogm.ready(module_ogm.mapper())


@pytest.fixture(scope="session")
def lab_recording(tmp_path_factory):
    """One lap of the lab's robot: 220 poses and 220 scans, as messages of their own."""
    folder = tmp_path_factory.mktemp("lab")
    started = Ogm(folder)
    try:
        ended = started.call("simulate", "--world", "lab", "--scans", 220, "--seed", 1, "--out", "lab.jsonl")
    finally:
        started.close()
    assert (ended.code, ended.err) == (0, "")
    return folder / "lab.jsonl"


def arrays(npz):
    """All arrays of an .npz file's bytes."""
    with np.load(io.BytesIO(npz)) as file:
        return dict(file)


@pytest.fixture
def assert_equal_maps():
    """Asserts that two maps are the same arrays under the same names, type, shape and every value."""

    def check(one, other):
        assert one.keys() == other.keys() >= {"log_odds", "resolution", "origin", "offset"}
        for name in one:
            assert one[name].dtype == other[name].dtype, name
            np.testing.assert_array_equal(one[name], other[name], strict=True, err_msg=name)

    return check


@pytest.fixture
def built(ogm):
    """What `ogm build` makes of messages: the map.npz, and what it says."""

    def build(messages, *flags, **environ):
        ogm.file("log.jsonl", lines(messages))
        ended = ogm.call("build", "log.jsonl", "--out", "map", *flags, **environ)
        assert ended.code == 0, ended
        return ogm.map("map/map.npz"), ended.err + ended.out

    return build
