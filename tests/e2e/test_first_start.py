"""The first start of a version: it compiles, says so, answers meanwhile, and ends when it is told to."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest

TIMEOUT = 120.0
ENDED = 20.0
"""How long a start may take to end, s: generous, for one that is not interrupted never ends here."""
WITHOUT_END = """
import sys
from numba import njit
from ogm_services.cli import main
from ogm_services.mapper.live import first_warm_up

def warm_up(settings, threads):
    while True:
        njit(lambda x: x + 1)(1)
        print("compiled", flush=True)

first_warm_up.warm_up = warm_up
sys.argv = ["ogm", SERVICE, "--http-port", "0", "--listen", "tcp/127.0.0.1:0"]
main()
"""


def answer(url):
    """Status and headers of a GET; None if nobody listens yet."""
    try:
        with urllib.request.urlopen(url, timeout=TIMEOUT) as response:
            return response.status, response.headers
    except urllib.error.HTTPError as error:
        return error.code, error.headers
    except OSError:
        return None


def test_it_says_that_it_compiles_and_answers_until_it_is_ready(ogm, eventually, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    flags, url = ("--http-port", port), f"http://127.0.0.1:{port}"
    first = ogm.mapper(*flags, NUMBA_CACHE_DIR=str(tmp_path / "kernels"))
    code, headers = eventually(lambda: answer(f"{url}/map.json"), TIMEOUT)
    assert (code, headers["content-type"]) == (503, "application/problem+json")
    assert int(headers["retry-after"]) > 0
    eventually(lambda: answer(f"{url}/readyz")[0] == 200, TIMEOUT)
    assert answer(f"{url}/map.json")[0] == 200
    _, said, done, _ = first.stop().err.splitlines()
    assert ": compiling the map's kernels, once for this version: about " in said
    assert ": compiled the map's kernels in " in done
    second = ogm.mapper(NUMBA_CACHE_DIR=str(tmp_path / "kernels"))
    ogm.ready(second)
    assert "compil" not in second.stop().err


@pytest.mark.parametrize(
    ("service", "number"),
    [("mapper", signal.SIGTERM), ("mapper", signal.SIGINT), ("gateway", signal.SIGTERM)],
)
def test_a_signal_ends_a_start_that_compiles_and_says_so(service, number, tmp_path):
    starting = subprocess.Popen(
        [sys.executable, "-c", f"SERVICE = {service!r}\n{WITHOUT_END}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
    )
    try:
        assert starting.stdout.readline() == "compiled\n"
        starting.send_signal(number)
        began = time.monotonic()
        out, err = starting.communicate(timeout=ENDED)
    finally:
        starting.kill()
        starting.wait()
    assert time.monotonic() - began < ENDED
    assert (starting.returncode, "Traceback" in err, "live map" in out) == (0, False, False), err
    assert ": compiling the map's kernels, once for this version: about 10 s" in err
    assert "compiled the map's" not in err
