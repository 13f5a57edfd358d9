"""Clients that get one URL again and again: wrk, or where that is not installed, threads of a process."""

import http.client
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

from benchmarks.running import STOPPED, program

TIMEOUT = 10.0
"""How long an answer may take, s."""


def have_wrk() -> bool:
    """Whether wrk is installed."""
    return shutil.which("wrk") is not None


def name() -> str:
    """What the clients are."""
    return "wrk" if have_wrk() else "Python threads"


@contextmanager
def clients(url: str, connections: int, seconds: float, *headers: str) -> Iterator[subprocess.Popen[bytes]]:
    """So many clients for so long, or until the end of the `with`; see `rate_of`."""
    if have_wrk():
        given = [part for header in headers for part in ("-H", header)]
        command = ["wrk", "-t1", f"-c{connections}", f"-d{max(1, round(seconds))}s", *given, url]
    else:
        command = [sys.executable, "-m", "benchmarks.http_clients", url, str(connections), str(seconds)]
    with program(command) as process:
        yield process


def rate_of(process: subprocess.Popen[bytes], seconds: float) -> float:
    """Answers a second that the clients got, when they are done.

    Raises:
        RuntimeError: there were none, some were errors, or the clients did not end in time.
    """
    try:
        text = process.communicate(timeout=seconds + TIMEOUT + STOPPED)[0].decode()
    except subprocess.TimeoutExpired as error:
        raise RuntimeError(f"{process.args!r} did not end") from error
    found = re.search(r"Requests/sec:\s*([\d.]+)", text)
    if found is None or float(found[1]) == 0.0 or "Non-2xx" in text or "Socket errors" in text:
        raise RuntimeError(f"{process.args!r}: {text}")
    return float(found[1])


def _main() -> None:
    """What wrk does, slower: url, number of clients and seconds are the arguments."""
    url, connections, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
    counts = [0] * connections
    end = time.monotonic() + seconds
    threads = [threading.Thread(target=_poll, args=(url, end, counts, k)) for k in range(connections)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    print(f"Requests/sec: {sum(counts) / seconds:.2f}")


def _poll(url: str, end: float, counts: list[int], k: int) -> None:
    parts = urlsplit(url)
    connection = http.client.HTTPConnection(parts.hostname or "", parts.port, timeout=TIMEOUT)
    while time.monotonic() < end:
        connection.request("GET", parts.path)
        response = connection.getresponse()
        response.read()
        assert response.status == 200, response.status
        counts[k] += 1
    connection.close()


if __name__ == "__main__":
    _main()
