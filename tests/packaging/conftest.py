"""What docker/Dockerfile says, done without Docker: all its instructions, in a folder that stands for `/`.

The commands are those of the Dockerfile, letter for letter, but for that folder before absolute paths. Only
what would change this machine's users is left out.
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"
LEFT_OUT = ("groupadd", "useradd", "chown")
STEP = 600.0
"""How long one RUN may take, s: it may download half a gigabyte."""
STOPPED = 30.0


@dataclass(frozen=True)
class Instruction:
    """One instruction of a Dockerfile: its name, its flags, and the rest."""

    name: str
    flags: dict[str, str]
    text: str

    @property
    def words(self):
        """The rest as a list, whether it is written as JSON or for a shell."""
        return json.loads(self.text) if self.text.startswith("[") else shlex.split(self.text)


def parse(text):
    """Stages of a Dockerfile, each a list of instructions that begins with FROM."""
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    stages = []
    for line in re.sub(r"\\\n\s*", "", "\n".join(lines)).splitlines():
        name, _, rest = line.partition(" ")
        flags = {}
        while match := re.match(r"--([a-z-]+)=(\S+)\s+", rest):
            flags[match[1]] = match[2]
            rest = rest[match.end() :]
        if name == "FROM":
            stages.append([])
        stages[-1].append(Instruction(name, flags, rest))
    return stages


@dataclass
class Stage:
    """One stage of a rehearsed build. Absolute paths are below `root`; all stages share it."""

    root: Path
    shims: Path
    folder: Path = field(init=False)
    environ: dict[str, str] = field(init=False)

    def __post_init__(self):
        self.folder = self.root
        self.environ = without_settings(os.environ)
        for name in ("VIRTUAL_ENV", "PYTHONPATH", "NUMBA_CACHE_DIR"):
            self.environ.pop(name, None)
        self.environ["PATH"] = f"{self.shims}:{os.environ['PATH']}"

    def inside(self, text):
        """A text whose absolute paths lead below `root`."""
        return re.sub(r"(?<![\w.:/$-])/(?=[a-z])", f"{self.root}/", text)

    def do(self, instruction):
        """Carry out one instruction, if it does anything."""
        action = getattr(self, f"_{instruction.name.lower()}", None)
        if action is not None:
            action(instruction)

    def _workdir(self, instruction):
        self.folder = Path(self.inside(instruction.text))
        self.folder.mkdir(parents=True)

    def _env(self, instruction):
        for word in shlex.split(instruction.text):
            name, _, value = word.partition("=")
            self.environ[name] = self.inside(value).replace("$PATH", self.environ["PATH"])

    def _copy(self, instruction):
        *sources, target = instruction.words
        if "from" in instruction.flags:
            assert Path(self.inside(sources[0])).is_dir()  # where the other stage has left it
            return
        for source in sources:
            if (ROOT / source).is_dir():
                ignored = shutil.ignore_patterns("__pycache__")
                shutil.copytree(ROOT / source, self.folder / target, ignore=ignored)
            else:
                shutil.copy(ROOT / source, self.folder / target)

    def _run(self, instruction):
        self.run(["sh", "-c", self.inside(instruction.text)], check=True)

    def run(self, words, *, check=False, **options):
        """Run a command to its end as this stage would."""
        ended = subprocess.run(
            words,
            cwd=self.folder,
            env=self.environ,
            capture_output=True,
            text=True,
            timeout=STEP,
            check=False,
            **options,
        )
        assert not check or ended.returncode == 0, f"{words}\n{ended.stdout}{ended.stderr}"
        return ended


@contextmanager
def running(words, *, log, **options):
    """Run a service, whose output goes to the file `log`; end it at the end, as `docker stop` would."""
    with log.open("w") as output:
        process = subprocess.Popen(words, stdout=output, stderr=subprocess.STDOUT, **options)
    try:
        yield process
        process.terminate()
        assert process.wait(STOPPED) == 0, log.read_text()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()


@pytest.fixture(scope="session")
def dockerfile():
    """Stages of docker/Dockerfile."""
    return parse((DOCKER / "Dockerfile").read_text())


@pytest.fixture(scope="session")
def image(dockerfile):
    """The last stage of the image after all instructions; whatever comes next runs as in a container."""
    with tempfile.TemporaryDirectory(prefix="ogm-image-") as folder:
        root, shims = Path(folder, "root"), Path(folder, "shims")
        for path in (root / "tmp", shims):
            path.mkdir(parents=True)
        shim = {"python": f'exec {shlex.quote(sys.executable)} "$@"', **dict.fromkeys(LEFT_OUT, "exit 0")}
        for name, line in shim.items():
            (shims / name).write_text(f"#!/bin/sh\n{line}\n")
            (shims / name).chmod(0o755)
        for instructions in dockerfile:
            stage = Stage(root, shims)
            for instruction in instructions:
                stage.do(instruction)
        yield stage


@pytest.fixture
def services(tmp_path):
    """`start(name, words, ...)` runs a service; all end with the test, the last one first."""
    with ExitStack() as ending:

        def start(name, words, **options):
            log = tmp_path / f"{name}.log"
            ending.enter_context(running(words, log=log, **options))
            return log

        yield start
