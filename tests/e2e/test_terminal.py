"""Commands whose terminal is closed: what they have made is written, whether that ends them or not."""

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import urllib.request

import pytest
import zenoh

from ogm_client.session import NetworkConfig, open_session
from ogm_services.ros2.mcap_reader import McapReader
from ogm_services.settings.sources import without_settings

FILES = {"map.png", "map.pgm", "map.yaml", "map.npz", "quality.json"}
STARTED = 60.0
ENDED = 20.0
IN_THE_TERMINAL = """
import fcntl, os, signal, sys, termios
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
signal.signal(signal.SIGHUP, getattr(signal, sys.argv[1]))
os.execv(sys.executable, [sys.executable, "-m", "ogm_services", *sys.argv[2:]])
"""


class Terminal:
    """A terminal, and the command that runs in it as its leader does."""

    def __init__(self, folder, hangup, *args):
        self._screen, inside = pty.openpty()
        self._open = True
        self._shown = ""
        self.process = subprocess.Popen(
            [sys.executable, "-c", IN_THE_TERMINAL, hangup, *map(str, args)],
            cwd=folder,
            env=without_settings(os.environ),
            stdin=inside,
            stdout=inside,
            stderr=inside,
            start_new_session=True,
        )
        os.close(inside)

    def shows(self, pattern):
        """The match of what the command prints, once it does."""
        while not (match := re.search(pattern, self._shown)):
            assert select.select([self._screen], [], [], STARTED)[0], self._shown
            self._shown += os.read(self._screen, 1000).decode()
        return match[1]

    def close(self):
        if self._open:
            self._open = False
            os.close(self._screen)


@pytest.fixture
def terminal(tmp_path):
    """`terminal(hangup, ...)` starts a command in a terminal; SIGHUP is SIG_DFL to it, or SIG_IGN."""
    started = []

    def start(hangup, *args):
        started.append(Terminal(tmp_path, hangup, *args))
        return started[-1]

    yield start
    for each in started:
        each.close()
        if each.process.poll() is None:
            os.killpg(each.process.pid, signal.SIGKILL)
            each.process.wait()


def status_of(url):
    with urllib.request.urlopen(f"{url}status", timeout=ENDED) as response:
        return json.load(response)


def mapper(terminal, ogm, hangup):
    """A mapper in a terminal, with some scans in its map, and the way to it."""
    ports = ("--http-port", 0, "--listen", "tcp/127.0.0.1:0")
    opened = terminal(hangup, "mapper", "--out", "out", *ports)
    endpoint = opened.shows(r"on Zenoh at (\S+)\r\n")
    url = opened.shows(r"live map (\S+)\r\n")
    assert ogm.run("simulate", "--scans", 5, "--connect", endpoint).code == 0
    return opened, endpoint, url


def written(folder):
    """The quality figures of a map that is all there."""
    assert {path.name for path in (folder / "out").iterdir()} == FILES
    return json.loads((folder / "out" / "quality.json").read_text())


def test_closing_the_terminal_ends_a_mapper_with_its_map_written(terminal, ogm, tmp_path, eventually):
    opened, _, url = mapper(terminal, ogm, "SIG_DFL")
    eventually(lambda: status_of(url)["revision"] == 5, ENDED)
    opened.close()
    assert opened.process.wait(ENDED) == 0
    assert written(tmp_path)["scans"] == 5


def test_under_nohup_a_mapper_outlives_its_terminal(terminal, ogm, tmp_path, eventually):
    opened, endpoint, url = mapper(terminal, ogm, "SIG_IGN")
    opened.close()
    with open_session(NetworkConfig(connect=(endpoint,))) as session:
        key = "ogm/v1/default/robots/r/scan/s"
        session.put(key, b"garbage", congestion_control=zenoh.CongestionControl.BLOCK)
        # Which it complains about, to nobody.
        eventually(lambda: status_of(url)["scans"]["dropped"]["malformed"] == 1, ENDED)
    eventually(lambda: status_of(url)["revision"] == 5, ENDED)
    opened.process.terminate()
    assert opened.process.wait(ENDED) == 0
    assert written(tmp_path)["scans"] == 5


def test_closing_the_terminal_ends_the_demo_with_its_map_written(terminal, tmp_path, eventually):
    opened = terminal("SIG_DFL", "demo", "--out", "out", "--http-port", 0, "--listen", "tcp/127.0.0.1:0")
    url = opened.shows(r"live map (\S+)\r\n")
    eventually(lambda: status_of(url)["revision"] > 3, ENDED)
    opened.close()
    assert opened.process.wait(ENDED) == 0
    assert written(tmp_path)["scans"] > 3
    with pytest.raises(ProcessLookupError):  # nobody is left behind
        os.killpg(opened.process.pid, 0)


def test_a_map_of_a_log_is_made_to_the_end_without_the_terminal(terminal, tmp_path, lab_recording):
    opened = terminal("SIG_IGN", "build", lab_recording, "--out", "out")
    opened.shows("(mapping)")
    opened.close()
    assert opened.process.wait(60.0) == 0
    assert written(tmp_path)["scans"] == 220


@pytest.mark.usefixtures("listener")
def test_a_recording_is_finished_without_the_terminal(terminal, ogm, tmp_path, endpoint):
    opened = terminal("SIG_DFL", "record", "--connect", endpoint, "-o", "a.mcap")
    opened.shows("(recording map default into a.mcap)")
    assert ogm.run("simulate", "--scans", 5, "--connect", endpoint).code == 0
    opened.shows(r"(5 scans and 5 poses of robot1, \d+\.\d MB)")
    opened.close()
    assert opened.process.wait(ENDED) == 0
    with McapReader(tmp_path / "a.mcap") as recording:
        assert len(list(recording)) == 10
        assert recording.doubt == ""


def test_what_nobody_reads_any_more_is_no_error_on_stderr_and_one_on_stdout():
    program = """
import os, sys
from ogm_services.runtime.terminal import outlive_terminal
outlive_terminal()
for stream in (sys.stderr, sys.stdout):
    reader, writer = os.pipe()
    os.dup2(writer, stream.fileno())
    os.close(writer)
    os.close(reader)
print("lost", file=sys.stderr, flush=True)
try:
    print("wanted", flush=True)
except BrokenPipeError:
    os._exit(7)
"""
    ended = subprocess.run([sys.executable, "-c", program], timeout=ENDED, check=False)
    assert ended.returncode == 7


@pytest.mark.parametrize("encoding", ["utf-8:strict", "ascii:strict"])
def test_a_name_that_the_terminal_cannot_show_is_printed_otherwise(tmp_path, encoding):
    """A file name is any bytes; a terminal's encoding says what it can show."""
    for name in (b"\xff.jsonl", "\N{SNOWMAN}.jsonl".encode()):
        done = subprocess.run(
            [sys.executable, "-m", "ogm_services", "simulate", "--scans", "1", "--out", os.fsdecode(name)],
            cwd=tmp_path,
            env={**without_settings(os.environ), "PYTHONIOENCODING": encoding, "PYTHONUTF8": "1"},
            capture_output=True,
            timeout=STARTED,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, b"")
        assert done.stdout.endswith(b".jsonl: 1 scans each of robot1\n")
        assert (tmp_path / os.fsdecode(name)).stat().st_size > 0
