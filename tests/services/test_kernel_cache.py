"""Where compiled kernels are kept: no change of the sources meets old ones, and any install works."""

import errno
import fcntl
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from numba.core import caching

from ogm_core.errors import BadSetting
from ogm_services.runtime import kernel_cache, kernel_files
from ogm_services.runtime.kernel_cache import KEPT, NoKernelCache
from ogm_services.settings.sources import without_settings

TIMEOUT = 60.0
NO_FILE_CAN_GROW = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0)); "
OGM = "import sys; sys.argv[0] = 'ogm'; from ogm_services.cli import main; main()"
SHARED = """
from numba import njit

@njit(cache=True)
def step(x):
    return x + {step}
"""
CALLER = """
from numba import njit
from toy.shared import step

@njit(cache=True)
def twice(x):
    return step(step(x))
"""
AS_NUMBA_DOES = "from toy.caller import twice; print(twice(0), sum(twice.stats.cache_hits.values()))"
AS_OGM_DOES = f"""
from pathlib import Path
from ogm_services.runtime import kernel_cache
kernel_cache._CORE = Path("toy").resolve()
with kernel_cache.kernel_cache():
    print(kernel_cache.begins_empty(), end=" ")
    {AS_NUMBA_DOES}
"""
FOR_A_FLOAT = AS_OGM_DOES.replace("twice(0)", "twice(2.5)")


def start(program, folder, **environ):
    """Start Python in a folder, its user's home beside it; it and what it starts are one group."""
    ours = without_settings(os.environ)
    for name in (kernel_cache.VARIABLE, kernel_cache.LOCATOR_VARIABLE, "XDG_CACHE_HOME", "TEMP", "TMP"):
        ours.pop(name, None)
    return subprocess.Popen(
        [sys.executable, *program],
        cwd=folder,
        env={**ours, "PYTHONPATH": str(folder), "HOME": str(folder / "home"), **environ},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ended(process):
    try:
        out, err = process.communicate(timeout=TIMEOUT)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@pytest.fixture
def ogm(tmp_path):
    """Runs `ogm` commands of a user whose home is a file, and whose temporary folder is an empty one."""
    (tmp_path / "home").touch()
    (tmp_path / "tmp").mkdir()

    def start_ogm(words, prelude="", **environ):
        return start(["-c", prelude + OGM, *words.split()], tmp_path, TMPDIR=str(tmp_path / "tmp"), **environ)

    return start_ogm


@pytest.fixture
def toy(tmp_path):
    """A kernel that calls another file's: `toy(step, program)` runs it with such a shared file."""
    (tmp_path / "toy").mkdir()
    (tmp_path / "toy/caller.py").write_text(CALLER)

    def started(step, program=AS_OGM_DOES, **environ):
        (tmp_path / "toy/shared.py").write_text(SHARED.format(step=step))
        return start(["-B", "-c", program], tmp_path, **environ)

    return started


def printed(process):
    done = ended(process)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


def test_a_change_of_a_shared_file_reaches_the_kernels_that_call_it(toy):
    assert printed(toy(1)) == ["True", "2", "0"]
    assert printed(toy(1)) == ["False", "2", "1"]
    assert printed(toy(5)) == ["True", "10", "0"]
    assert printed(toy(1)) == ["False", "2", "1"]  # the former state's are still there


def test_another_install_of_the_same_sources_finds_them(toy, tmp_path):
    kernels = str(tmp_path / "kernels")
    assert printed(toy(1, NUMBA_CACHE_DIR=kernels)) == ["True", "2", "0"]
    elsewhere = tmp_path / "elsewhere"
    shutil.copytree(tmp_path / "toy", elsewhere / "toy")
    again = start(["-B", "-c", AS_OGM_DOES], elsewhere, NUMBA_CACHE_DIR=kernels)
    assert printed(again) == ["False", "2", "1"]


def test_numba_left_alone_goes_on_with_the_old_code(toy):
    assert printed(toy(1, AS_NUMBA_DOES)) == ["2", "0"]
    assert printed(toy(5, AS_NUMBA_DOES)) == ["2", "1"]


def test_two_that_start_at_once_in_an_empty_folder_both_work(toy, tmp_path):
    both = [toy(3, NUMBA_CACHE_DIR=str(tmp_path / "kernels")) for _ in range(2)]
    assert [printed(process)[1] for process in both] == ["6", "6"]
    assert printed(toy(3, NUMBA_CACHE_DIR=str(tmp_path / "kernels"))) == ["False", "6", "1"]


def test_two_that_compile_a_kernel_for_different_types_at_once_get_their_own(toy, tmp_path):
    """As if both had looked for a free name before either wrote: the second does not see the first's list."""
    kernels = str(tmp_path / "kernels")
    assert printed(toy(1, NUMBA_CACHE_DIR=kernels)) == ["True", "2", "0"]
    first = {file: file.read_bytes() for file in tmp_path.rglob("*.nbc")}
    for index in tmp_path.rglob("*.nbi"):
        index.unlink()
    assert printed(toy(1, FOR_A_FLOAT, NUMBA_CACHE_DIR=kernels)) == ["True", "4.5", "0"]
    assert {file: file.read_bytes() for file in first} == first
    assert len(set(tmp_path.rglob("*.nbc")) - set(first)) == len(first) == 2


@pytest.mark.parametrize(
    ("suffix", "damage"), [("nbi", b""), ("nbc", b"\x80\x05cut off"), ("nbc", b"no pickle at all")]
)
def test_what_a_power_cut_has_left_is_as_if_it_were_not_there(tmp_path, suffix, damage):
    assert caching.IndexDataCacheFile.__module__ == kernel_files.__name__
    kernel = caching.IndexDataCacheFile(str(tmp_path), "kernel", "stamp")
    kernel.save("float64", "its code")
    assert kernel.load("float64") == "its code"
    (file,) = tmp_path.glob(f"*.{suffix}")
    file.write_bytes(damage)
    assert kernel.load("float64") is None
    kernel.save("float64", "its code, compiled again")
    assert kernel.load("float64") == "its code, compiled again"


def test_where_there_is_no_more_room_kernels_are_compiled_and_not_kept(toy, tmp_path):
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100)); " + AS_OGM_DOES
    done = ended(toy(1, full, NUMBA_CACHE_DIR=str(tmp_path / "kernels")))
    assert (done.returncode, done.stdout.split()) == (0, ["True", "2", "0"])
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"ogm: compiled kernels cannot be kept in {tmp_path}/kernels/ogm-")
    assert line.endswith(": File too large: they are compiled at every start")
    assert list(tmp_path.rglob("*.nbc")) == []


def test_any_program_can_be_run_with_kernels_kept_so(tmp_path):
    show = "import os, sys; print(os.environ['NUMBA_CACHE_DIR']); sys.exit(3)"
    module = ["-m", "ogm_services.runtime.kernel_cache"]
    done = ended(start([*module, sys.executable, "-c", show], tmp_path))
    assert (done.returncode, done.stderr) == (3, "")
    assert Path(done.stdout.strip()).parent == tmp_path / "home/.cache/zenoh-ogm/kernels"
    refused = ended(start([*module, "true"], tmp_path, NUMBA_CACHE_DIR="/dev/null"))
    assert (refused.returncode, refused.stderr.count("\n")) == (1, 1)


def test_the_demo_and_its_processes_share_one_temporary_folder(ogm, tmp_path, eventually):
    demo = ogm("demo --http-port 0 --listen tcp/127.0.0.1:0")
    try:
        kernels = eventually(lambda: list((tmp_path / "tmp").rglob("*.nbc")), TIMEOUT)
        (folder,) = (tmp_path / "tmp").glob("ogm-kernels-*")
    finally:
        demo.terminate()
        done = ended(demo)
    assert {kernel.parents[2] for kernel in kernels} == {folder}  # the mapper's, in what the demo has made
    assert done.returncode == 0, done.stderr
    line = done.stderr.splitlines()[0]
    assert line.startswith(f"ogm: {tmp_path}/home/.cache/zenoh-ogm/kernels cannot be written: ")
    assert "longer" in line
    assert line.endswith("set NUMBA_CACHE_DIR to a folder that lasts")
    assert list((tmp_path / "tmp").iterdir()) == []


@pytest.mark.parametrize("command", ["build log.jsonl --out map", "mapper", "demo"])
def test_a_folder_that_cannot_be_written_is_refused_in_one_line(ogm, command):
    done = ended(ogm(command, NUMBA_CACHE_DIR="/dev/null"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "ogm: NUMBA_CACHE_DIR /dev/null: cannot be written: Not a directory; give a folder for compiled "
        "kernels, or unset it\n"
    )


def test_commands_without_kernels_need_no_folder(ogm):
    done = ended(ogm("simulate --scans 1 --out log.jsonl", NUMBA_CACHE_DIR="/dev/null"))
    assert (done.returncode, done.stderr) == (0, "")


def test_to_run_no_program_is_bad_usage(capsys):
    assert kernel_cache.main([]) == 2
    said = "ogm: a command is needed: python -m ogm_services.runtime.kernel_cache COMMAND ...\n"
    assert capsys.readouterr() == ("", said)


def test_nothing_can_be_written_at_all(ogm):
    done = ended(ogm("build log.jsonl --out map", NO_FILE_CAN_GROW))
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "compiled kernels can be kept nowhere, not even in a temporary folder: " in done.stderr
    assert "set NUMBA_CACHE_DIR" in done.stderr


def lock(place):
    """Put a folder there that takes no files; permissions would not stop root."""
    shutil.rmtree(place, ignore_errors=True)
    place.symlink_to("/proc")


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The places where kernels may be kept, for this process: of the user, temporary; and other sources."""
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


def chosen():
    with kernel_cache.kernel_cache() as folder:
        assert told() == str(folder)
    return folder


def test_the_user_has_a_folder_for_every_state_of_the_sources(places, capsys):
    first = chosen()
    assert told() is None
    assert first.parent == places / "user/zenoh-ogm/kernels"
    assert chosen() == first
    (places / "core/lattice.py").write_text("SIZE = 65\n")
    second = chosen()
    (places / "core/cells").mkdir()
    (places / "core/lattice.py").rename(places / "core/cells/lattice.py")
    assert len({first, second, chosen()}) == 3
    assert list((places / "tmp").iterdir()) == []
    assert capsys.readouterr().err == ""


def test_another_compiler_has_a_folder_of_its_own(places, monkeypatch):
    first = chosen()
    monkeypatch.setattr(kernel_cache, "version", lambda name: "0.1")
    assert chosen() != first


def test_a_folder_that_is_given_has_such_folders_too(places, monkeypatch):
    monkeypatch.setenv(kernel_cache.VARIABLE, str(places / "lasting"))
    outer = chosen()
    assert outer.parent == places / "lasting"
    with kernel_cache.kernel_cache(), kernel_cache.kernel_cache() as inner:  # as in a process of the demo's
        assert inner == outer
        assert kernel_cache.lasts()
    assert told() == str(places / "lasting")


def test_kernels_of_other_sources_go_when_nobody_uses_them_for_long(places):
    mine = chosen()
    names = "ogm-00000000000000aa", "ogm-00000000000000bb", "ogm-00000000000000cc", "no-kernels"
    old, running, young, others = (mine.parent / name for name in names)
    for folder in (old, running, young, others):
        folder.mkdir()
        (folder / "kernel.nbc").touch()
        os.utime(folder, (0, time.time() - (KEPT + 60 if folder != young else KEPT - 60)))
    with (running / "in-use").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_SH)
        os.utime(running, (0, time.time() - KEPT - 60))
        os.utime(mine, (0, 0))
        assert chosen() == mine
        assert mine.stat().st_mtime > time.time() - 60
        assert old.exists()  # nothing is looked through before there is a new folder
        (places / "core/lattice.py").write_text("SIZE = 65\n")
        newest = chosen()
    assert {*mine.parent.iterdir()} == {mine, newest, running, young, others}


def test_a_folder_says_that_it_is_in_use(places):
    with kernel_cache.kernel_cache() as folder, (folder / "in-use").open("a") as other:
        with pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        assert chosen() == folder  # others may use it, too
    at = (folder / "in-use").stat().st_mtime_ns
    assert chosen() == folder
    assert (folder / "in-use").stat().st_mtime_ns == at  # a folder that is full is only read
    with (folder / "in-use").open("a") as other:
        fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_a_disk_without_room_for_a_folder_that_is_given_is_told_and_no_end(places, monkeypatch, capsys):
    monkeypatch.setenv(kernel_cache.VARIABLE, str(places / "given"))
    fault = kernel_cache._fault
    full = OSError(errno.ENOSPC, "No space left on device")
    monkeypatch.setattr(kernel_cache, "_fault", lambda at: full if "given" in str(at) else fault(at))
    with kernel_cache.kernel_cache() as folder:
        assert folder.parent.parent == places / "tmp"
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"ogm: {places}/given cannot be written: kernels are compiled at every start")


def test_the_temporary_folder_is_private_and_gone_afterwards(places, capsys):
    lock(places / "user")
    with kernel_cache.kernel_cache() as folder:
        assert told() == str(folder)
        assert folder.parent.parent == places / "tmp"
        assert stat.S_IMODE(folder.parent.stat().st_mode) == 0o700
        assert not kernel_cache.lasts()
        assert kernel_cache.begins_empty()
        folder.mkdir()
        (folder / "kernel.nbi").touch()
        assert not kernel_cache.begins_empty()
    assert told() is None
    assert list((places / "tmp").iterdir()) == []
    assert str(places / "user/zenoh-ogm/kernels") in capsys.readouterr().err
    lock(places / "tmp")
    with pytest.raises(NoKernelCache), kernel_cache.kernel_cache():
        pytest.fail("there is nowhere to keep kernels")


def test_a_user_without_a_home_gets_a_temporary_folder_and_none_named_tilde(places, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    monkeypatch.chdir(places)
    assert chosen().is_relative_to(places / "tmp")
    assert not (places / "~").exists()


def test_an_empty_name_is_as_good_as_none(places, monkeypatch):
    monkeypatch.setenv(kernel_cache.VARIABLE, "")
    assert chosen().is_relative_to(places / "user")
    assert told() == ""


def test_a_refused_folder_leaves_the_environment_as_it_was(places, monkeypatch):
    lock(places / "file")
    monkeypatch.setenv(kernel_cache.VARIABLE, str(places / "file"))
    with pytest.raises(BadSetting, match=str(places / "file")), kernel_cache.kernel_cache():
        pytest.fail("nothing can be written there")
    assert told() == str(places / "file")
