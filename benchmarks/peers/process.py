"""Build the peers, and run one beside this program, round by round."""

import glob
import json
import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ogm_core.errors import OgmError

SOURCES = Path(__file__).parent
FLAGS = ["-std=c++17", "-O3", "-march=native", "-ffp-contract=off"]
"""No fused multiply-add: it rounds otherwise than the map, and the textbook is to equal it bit for bit."""
PROGRAMS = {
    "textbook": ["textbook.cpp"],
    "textbook-sized": ["textbook.cpp", "-DSIZED"],
    "mrpt": [
        "mrpt.cpp",
        *(f"-lmrpt-{part}" for part in ("maps", "obs", "poses", "math", "core", "rtti", "serialization")),
    ],
    "octomap": ["octomap.cpp", "-loctomap", "-loctomath"],
}
"""The source of every peer, and the compiler's arguments after it."""
INCLUDES = {"mrpt": ["/usr/include/eigen3", "/usr/include/mrpt/*/include"]}
"""Folders of headers, as patterns, beside those that the compiler looks into anyway."""


class NoPeer(OgmError):
    """A peer cannot be built here."""


def build(name: str, folder: Path) -> Path:
    """Compile a peer unless that was done since its sources changed; return the program.

    Raises:
        NoPeer: there is no g++, or the peer's library is not installed.
    """
    compiler = shutil.which("g++")
    if compiler is None:
        raise NoPeer(f"{name}: there is no g++ to build it")
    source, *arguments = PROGRAMS[name]
    program = folder / name
    newest = max(
        path.stat().st_mtime for path in (SOURCES / source, SOURCES / "workload.hpp", Path(__file__))
    )
    if program.exists() and program.stat().st_mtime > newest:
        return program
    folder.mkdir(parents=True, exist_ok=True)
    includes = [f"-I{path}" for pattern in INCLUDES.get(name, []) for path in glob.glob(pattern)]  # noqa: PTH207
    command = [compiler, *FLAGS, *includes, str(SOURCES / source), *arguments, "-o", str(program)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        reasons = [line for line in done.stderr.splitlines() if "error" in line or "cannot find" in line]
        raise NoPeer(f"{name}: it does not build here: {(reasons or ['no reason given'])[0]}")
    return program


class Peer:
    """A peer's process with a workload loaded; use as a context manager."""

    def __init__(self, program: Path, workload: Path) -> None:
        """Start the program, and wait until it has read the workload file."""
        self.name = program.name
        self.updates = 0
        """Cell updates of the last round; negative if the program does not count them."""
        self._process = subprocess.Popen(
            [str(program), str(workload)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.pid = self._process.pid
        self._answer()

    def round(self) -> NDArray[np.float64]:
        """Map the workload afresh; return the CPU time of every scan, us."""
        answer = self._ask("round")
        self.updates = int(answer["updates"])
        return np.array(answer["us"])

    def dump(self, path: Path) -> None:
        """Write the map that the last round made, once: see `read_map`."""
        self._ask(f"dump {path}")

    def _ask(self, command: str) -> dict[str, Any]:
        assert self._process.stdin is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            self._process.communicate()
            raise NoPeer(f"{self.name}: it ended with code {self._process.returncode}")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def __enter__(self) -> "Peer":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process.returncode is None:
            self._process.communicate("quit\n")
