"""Where compiled kernels are kept: an install that cannot be written works, and says what it lacks."""

import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from ogm_core.errors import BadSetting
from ogm_services.runtime import kernel_cache
from ogm_services.runtime.kernel_cache import NoKernelCache
from ogm_services.settings.sources import without_settings

ROOT = Path(__file__).parents[2]
PACKAGES = ("ogm_core", "services/ogm_services", "clients/ogm_client")
TIMEOUT = 60.0
NO_FILE_CAN_GROW = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); "
PROGRAM = "import sys; sys.argv[0] = 'ogm'; from ogm_services.cli import main; main()"


class Installed:
    """A copy of the packages that lets nobody write into it, root included; and a home that is a file."""

    def __init__(self, folder):
        self.packages, self.home, self.tmp = folder / "packages", folder / "home", folder / "tmp"
        for package in PACKAGES:
            target = self.packages / Path(package).name
            shutil.copytree(ROOT / package, target, ignore=shutil.ignore_patterns("__pycache__"))
        lock(self.packages / "ogm_core/__pycache__")
        self.home.touch()
        self.tmp.mkdir()
        self.log = folder / "log.jsonl"
        assert self.run("simulate", "--scans", 2, "--out", self.log).returncode == 0

    def start(self, *args, prelude="", **environ):
        """Start a command; it and what it starts are one group of processes."""
        ours = without_settings(os.environ)
        for name in (kernel_cache.VARIABLE, "XDG_CACHE_HOME", "TEMP", "TMP"):
            ours.pop(name, None)
        places = {"PYTHONPATH": str(self.packages), "HOME": str(self.home), "TMPDIR": str(self.tmp)}
        return subprocess.Popen(
            [sys.executable, "-c", prelude + PROGRAM, *map(str, args)],
            cwd=self.tmp.parent,  # not the checkout, which Python would look into first
            env={**ours, **places, **environ},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )

    def run(self, *args, **options):
        """Run a command to its end."""
        return ended(self.start(*args, **options))

    def build(self, **options):
        """Map the log; every kernel that this needs is compiled or found."""
        return self.run("build", self.log, "--out", self.log.with_name("map"), **options)


def lock(place):
    """Put a folder there that takes no files; permissions would not stop root."""
    shutil.rmtree(place, ignore_errors=True)
    place.symlink_to("/proc")


def ended(process):
    try:
        out, err = process.communicate(timeout=TIMEOUT)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    return Installed(tmp_path_factory.mktemp("installed"))


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The places where kernels may be kept, for this process: beside the sources, of the user, temporary."""
    for name in ("core", "user", "tmp"):
        (tmp_path / name).mkdir()
    (tmp_path / "core/lattice.py").write_text("SIZE = 64\n")
    monkeypatch.setattr(kernel_cache, "_CORE", tmp_path / "core")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    monkeypatch.delenv(kernel_cache.VARIABLE, raising=False)
    return tmp_path


def told():
    """The folder that numba would be told now."""
    return os.environ.get(kernel_cache.VARIABLE)


def test_an_install_that_cannot_be_written_builds_and_says_that_it_takes_longer(installed):
    done = installed.build()
    assert (done.returncode, done.stdout.count("2 integrated")) == (0, 1), done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ogm: neither {installed.packages}/ogm_core/__pycache__ nor {installed.home}/")
    assert "longer" in line
    assert line.endswith("set NUMBA_CACHE_DIR to a folder that lasts")
    assert list(installed.tmp.iterdir()) == []


def test_the_demo_and_its_processes_share_one_temporary_folder(installed, eventually):
    demo = installed.start("demo", "--http-port", 0, "--listen", "tcp/127.0.0.1:0")
    try:
        kernels = eventually(lambda: list(installed.tmp.rglob("*.nbc")), TIMEOUT)
        (folder,) = installed.tmp.glob("ogm-kernels-*")
    finally:
        demo.terminate()
        done = ended(demo)
    assert {kernel.parents[2] for kernel in kernels} == {folder}  # the mapper's, in what the demo has made
    assert (done.returncode, done.stderr.count("\n")) == (0, 1), done.stderr
    assert list(installed.tmp.iterdir()) == []


def test_a_folder_that_lasts_is_used_by_the_next_start(installed, tmp_path):
    def kernels():
        return {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.nb?")}

    runs = []
    for _ in range(2):
        done = installed.build(NUMBA_CACHE_DIR=str(tmp_path))
        assert (done.returncode, done.stderr) == (0, "")
        runs.append(kernels())
    assert runs[0] == runs[1] != {}
    assert list(installed.tmp.iterdir()) == []


@pytest.mark.parametrize("command", ["build LOG --out DIR", "mapper", "demo"])
def test_a_folder_that_cannot_be_written_is_refused_in_one_line(installed, command):
    done = installed.run(*command.replace("LOG", str(installed.log)).split(), NUMBA_CACHE_DIR="/dev/null")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "ogm: NUMBA_CACHE_DIR /dev/null: cannot be written: Not a directory; give a folder for compiled "
        "kernels, or unset it\n"
    )


def test_commands_without_kernels_need_no_folder(installed):
    done = installed.run("simulate", "--scans", 1, "--out", installed.log, NUMBA_CACHE_DIR="/dev/null")
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_can_be_written_at_all(installed):
    done = installed.build(prelude=NO_FILE_CAN_GROW)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "compiled kernels can be kept nowhere, not even in a temporary folder: " in done.stderr
    assert "set NUMBA_CACHE_DIR" in done.stderr


@pytest.mark.parametrize("place", ["core/__pycache__", "user/numba"])
def test_numba_is_left_alone_where_it_finds_a_folder(places, place, capsys):
    if place.startswith("user"):
        lock(places / "core/__pycache__")
    with kernel_cache.kernel_cache():
        assert told() is None
    assert list((places / "tmp").iterdir()) == []
    assert list((places / place).iterdir()) == []
    assert capsys.readouterr().err == ""


def test_the_temporary_folder_is_private_and_gone_afterwards(places, monkeypatch, capsys):
    lock(places / "core/__pycache__")
    lock(places / "user")
    with kernel_cache.kernel_cache():
        folder = Path(told()).parent
        assert folder.parent == places / "tmp"
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
        Path(told()).mkdir()
        Path(told(), "kernel.nbc").touch()
    assert told() is None
    assert list((places / "tmp").iterdir()) == []
    assert str(places / "user/numba") in capsys.readouterr().err
    lock(places / "tmp")
    with pytest.raises(NoKernelCache), kernel_cache.kernel_cache():
        pytest.fail("there is nowhere to keep kernels")


def test_a_user_without_a_home_gets_a_temporary_folder_and_none_named_tilde(places, monkeypatch):
    lock(places / "core/__pycache__")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    monkeypatch.chdir(places)
    with kernel_cache.kernel_cache():
        assert Path(told()).is_relative_to(places / "tmp")
    assert not (places / "~").exists()


def test_a_folder_that_lasts_has_a_subfolder_for_every_state_of_the_sources(places, monkeypatch):
    monkeypatch.setenv(kernel_cache.VARIABLE, str(places / "lasting"))

    def chosen():
        with kernel_cache.kernel_cache():
            outer = told()
            with kernel_cache.kernel_cache():  # as in a process that the demo starts
                assert told() == outer
        assert told() == str(places / "lasting")
        return outer

    first = chosen()
    assert Path(first).parent == places / "lasting"
    assert chosen() == first
    (places / "core/lattice.py").write_text("SIZE = 65\n")
    second = chosen()
    (places / "core/lattice.py").rename(places / "core/logodds.py")
    assert len({first, second, chosen()}) == 3


def test_an_empty_name_is_as_good_as_none(places, monkeypatch):
    monkeypatch.setenv(kernel_cache.VARIABLE, "")
    with kernel_cache.kernel_cache():
        assert told() == ""
    lock(places / "core/__pycache__")
    lock(places / "user")
    with kernel_cache.kernel_cache():
        assert Path(told()).is_relative_to(places / "tmp")
    assert told() == ""


def test_a_refused_folder_leaves_the_environment_as_it_was(places, monkeypatch):
    lock(places / "file")
    monkeypatch.setenv(kernel_cache.VARIABLE, str(places / "file"))
    with pytest.raises(BadSetting, match=str(places / "file")), kernel_cache.kernel_cache():
        pytest.fail("nothing can be written there")
    assert told() == str(places / "file")
