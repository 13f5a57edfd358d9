"""A mapper stops in bounded time, whatever does not end in it; its map is written if nobody writes on it.

So does a gateway.
"""

import re
import signal
import subprocess
import sys
import threading
import urllib.request
from contextlib import suppress

import pytest

from mapper_desk import Desk, Sink
from ogm_services.runtime.bounded_close import Closing

CHILD = """
import threading
import numpy as np
from ogm_core.placing.scan_placer import ScanPlacer
from ogm_core.types import Pose, Scan
from ogm_services.cli import app
from ogm_services.mapper import service
from ogm_services.mapper.serving.answers import Answers

def for_ever(*_):
    print("it begins", flush=True)
    threading.Event().wait()

wait = service.MapperService.wait

def with_a_map(mapper):
    mapper.live_map.integrate(Scan(0, 0.0, 0.1, 0.0, 8.0, np.full(3, 2.0, np.float32)), Pose(0.25, 0.25, 0.0))
    wait(mapper)

service.MapperService.wait = with_a_map
service.STOP_TIME = service.WORKER_TIME = 0.5
"""
GATEWAY = """
import threading
from ogm_services.cli import app
from ogm_services.mapper.gateway import gateway_service
from ogm_services.mapper.gateway.gathered_answers import GatheredAnswers

def for_ever(*_):
    print("it begins", flush=True)
    threading.Event().wait()

gateway_service.STOP_TIME = 0.5
"""
RUN = "\napp()\n"


def run(patch, folder, meanwhile=lambda url: None):
    """Run a mapper with a patch until something in it does not end, and stop it: stderr's last lines."""
    return run_child(CHILD + patch, ["mapper", "--out", str(folder)], meanwhile)


def run_child(code, options, meanwhile=lambda url: None):
    """Run any service, likewise."""
    listens = ["--listen", "tcp/127.0.0.1:0", "--http-port", "0"]
    command = [sys.executable, "-c", code + RUN, *options, *listens]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as child:
        timer = threading.Timer(120, child.kill)
        timer.start()
        try:
            lines = []
            for line in child.stdout:
                lines.append(line)
                if found := re.search(r"http://\S+", line):
                    meanwhile(found[0])
                if "it begins\n" in lines and any("http" in line for line in lines):
                    break
            child.send_signal(signal.SIGTERM)
            child.send_signal(signal.SIGINT)
            _, errors = child.communicate(timeout=60)
        finally:
            timer.cancel()
            child.kill()
    assert child.returncode == 1, errors
    return [line for line in errors.splitlines() if line.startswith("ogm: ")]


def test_a_worker_that_does_not_end_ends_with_the_process_and_the_newest_copy_of_the_map_is_written(tmp_path):
    def copy(url):
        with urllib.request.urlopen(f"{url}map.npz", timeout=60) as answer:
            copied.append(answer.read())

    copied = []
    written, stopped = run("ScanPlacer.expire = for_ever", tmp_path, copy)
    assert written == (
        f"ogm: the map's files in {tmp_path} are of revision 1: what came after it does not end"
    )
    why = "the mapper has not stopped within 0.5 s, so it ends as it is: Worker.stop does not return"
    assert stopped.startswith(f"ogm: {why}; threads that go on: ")
    assert "ogm-worker" in stopped
    assert {path.name for path in tmp_path.iterdir()} == {"map.npz", "map.png", "map.pgm", "map.yaml"}
    assert (tmp_path / "map.npz").read_bytes() == copied[0]


def ask(url):
    """Ask for a cell, and do not wait for the answer."""

    def get():
        with suppress(OSError):
            urllib.request.urlopen(f"{url}cell?x=0&y=0", timeout=60)

    threading.Thread(target=get, daemon=True).start()


def test_a_question_that_does_not_end_ends_with_the_process_and_the_map_is_written(tmp_path):
    (stopped,) = run("Answers.cell = for_ever", tmp_path, ask)
    assert "so it ends as it is: HttpThread.__exit__ does not return; threads that go on:" in stopped
    assert "ogm-maps" in stopped
    assert {path.name for path in tmp_path.iterdir()} >= {"map.png", "map.npz", "quality.json"}


def test_a_gateway_ends_with_a_question_that_does_not():
    (stopped,) = run_child(GATEWAY + "GatheredAnswers.cell = for_ever", ["gateway"], ask)
    why = "ogm: the gateway has not stopped within 0.5 s, so it ends as it is: HttpThread.__exit__"
    assert stopped.startswith(f"{why} does not return; threads that go on: ")
    assert "ogm-maps" in stopped


def test_what_closing_raises_is_raised():
    with pytest.raises(ZeroDivisionError):
        Closing(lambda: 1 / 0).held_after(20.0)
    assert Closing(lambda: None).held_after(20.0) is None


def test_scans_that_one_pose_makes_ready_stay_waiting_once_the_placer_is_to_stop():
    sink = Sink()
    desk = Desk(sink, stopping=lambda: len(sink.placed) >= 3)
    desk.pose(0)
    for ms in range(100, 110):
        desk.scan(ms)
    desk.pose(200)
    assert desk.order == [0, 1, 2]
    assert (desk.pending, desk.dropped) == (7, {})
