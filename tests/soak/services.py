"""Services of the soak that are killed and frozen: a mapper that stores its map, robots, a router."""

import json
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx

from benchmarks.running import ROOT, environment, line_after
from tests.soak.drives import SENSOR

FLAGS = ("--http-port", "0", "--log-level", "info")


class Service:
    """A process that can be killed, frozen and started again; whatever happens, it ends with its context."""

    def __init__(self, module: str, *arguments: object) -> None:
        self._command = [sys.executable, "-m", module, *map(str, arguments)]
        self._log: Any = None
        self.environ: dict[str, str] = {}
        """What it finds in its environment besides, at its next start."""
        self.process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it; wait for nothing."""
        assert self.process is None
        self.process = subprocess.Popen(
            self._command,
            cwd=ROOT,
            env=environment() | self.environ,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            bufsize=0,
        )

    def end(self, number: signal.Signals = signal.SIGKILL) -> None:
        """End it, as a power cut would or in order, by SIGTERM."""
        assert self.process is not None
        self.process.send_signal(number)
        code = self.process.wait()
        assert code == (0 if number == signal.SIGTERM else -number), f"{self._command} ended with {code}"
        self._close()

    @contextmanager
    def frozen(self) -> Iterator[None]:
        """Have it stand still meanwhile."""
        assert self.process is not None
        self.process.send_signal(signal.SIGSTOP)
        try:
            yield
            state = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(") ")[2][0]
            assert state == "T", f"{self._command} is in state {state}"
        finally:
            self.process.send_signal(signal.SIGCONT)

    def _close(self) -> None:
        assert self.process is not None
        for pipe in (self.process.stdin, self.process.stdout):
            with suppress(OSError):
                pipe.close()  # type: ignore[union-attr]
        self.process = None

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()
            self._close()


class Mapper(Service):
    """`ogm mapper --data`, and what its lives have counted, as they told last; of a share with `share`."""

    def __init__(self, endpoint: str, folder: Path, how: str, flags: dict[str, object]) -> None:
        self._served_at = "status   " if "share" in flags else "live map "
        settings = (f"--{name.replace('_', '-')}={value}" for name, value in flags.items())
        listens = ("--listen", "tcp/127.0.0.1:0") if how == "connect" and "share" not in flags else ()
        super().__init__(
            "ogm_services", "mapper", f"--{how}", endpoint, *listens, "--data", folder, *FLAGS, *settings
        )
        self.log_file = folder.with_suffix(".log")
        self.runs: set[str] = set()
        self._ended: Counter[str] = Counter()
        """Of lives that are over, what each counts anew."""
        self._scans: Counter[str] = Counter()
        """Scans that were dropped or lost, in this life and those before."""
        self._life: Counter[str] = Counter()
        self.url = ""
        """Where it is reached over HTTP while it is ready; then with a slash at its end."""
        self._closing = ExitStack()

    def start(self) -> None:
        """Start it; wait for nothing."""
        self._log = self._closing.enter_context(self.log_file.open("ab"))
        super().start()
        self.url = ""

    def wait_until_ready(self) -> None:
        """Return once it serves."""
        assert self.process is not None
        self.url = line_after(self.process, self._served_at)
        self.runs.add(self.status()["run"])

    def status(self) -> dict[str, Any]:
        """What it says of itself."""
        status = httpx.get(f"{self.url}status", timeout=60.0).raise_for_status().json()
        scans = status["scans"]
        poses = {f"poses {name}": count for name, count in status["poses"].items() if name != "received"}
        self._life = Counter({**poses, "scans replayed": scans["replayed"]})
        self._scans = Counter({**scans["dropped"], "scans lost": scans["lost"]})
        return status

    @property
    def waiting(self) -> int:
        """Scans that wait in its queue; 0 while it is not ready. Any thread."""
        try:
            counts = httpx.get(f"{self.url}status", timeout=5.0).raise_for_status().json()["scans"]
        except (httpx.HTTPError, httpx.InvalidURL):  # it is being killed, or starts
            return 0
        return int(counts["pending"])

    @property
    def anybody_alive(self) -> bool:
        """Whether any robot's token is there."""
        return any(robot["alive"] for robot in self.status()["robots"].values())

    def arrived(self) -> dict[int, int]:
        """Scans of each robot's present run that have come, once no more do: none of them may be alive."""
        arrived, looked = self.has_heard(), {}
        while arrived != looked:
            time.sleep(2.0)  # longer than a robot is held whose caches are gone
            arrived, looked = self.has_heard(), arrived
        return arrived

    def has_heard(self) -> dict[int, int]:
        """Scans of each robot's present run that have come so far."""
        robots = self.status()["robots"]
        return {int(name[5:]): robot["sources"][SENSOR]["last_seq"] + 1 for name, robot in robots.items()}

    @property
    def counted(self) -> Counter[str]:
        """What its lives have counted, but for this one's poses and scans that came again."""
        return self._ended + self._scans

    def map(self) -> tuple[bytes, int]:
        """Its /map.npz, and the revision of that."""
        answer = httpx.get(f"{self.url}map.npz", timeout=60.0).raise_for_status()
        return answer.content, int(answer.headers["OGM-Revision"])

    def end(self, number: signal.Signals = signal.SIGKILL) -> None:
        """End it; it is asked what it has counted before, if it is ready."""
        if self.url:
            self.status()
        super().end(number)

    def _close(self) -> None:
        super()._close()
        self._closing.close()
        self._ended += self._life
        self._life.clear()


class Robots(Service):
    """Robots, all of them one process: `sent` is how many scans each has published when it is asked."""

    def __init__(
        self,
        endpoint: str,
        robots: Iterable[int],
        rate: float,
        *,
        within: float = 0.0,
        run: int = 0,
        sight: str = "near",
    ) -> None:
        self.endpoint, self.rate, self.sight = endpoint, rate, sight
        self.hz = 0.0
        """Scans that a robot has published a second, on average, when they were asked last."""
        self._asking = threading.Lock()
        super().__init__("tests.soak.driving", endpoint, f"run{run}", rate, within, sight, *robots)

    def sent(self) -> dict[int, int]:
        """Scans that each robot has published."""
        return self._ask("")

    def go_at(self, pace: float) -> None:
        """Have them publish so many times as fast as their rate says."""
        self._ask(f"pace {pace}")

    def stop(self) -> dict[int, int]:
        """Have them publish no more; what they have published they keep."""
        return self._ask("stop")

    def _ask(self, line: str) -> dict[int, int]:
        assert self.process is not None
        with self._asking:  # the test's thread and that of a Pacer
            self.process.stdin.write(f"{line}\n".encode())  # type: ignore[union-attr]
            told, self.hz = json.loads(line_after(self.process, "sent "))
        return {int(robot): count for robot, count in told.items()}
