"""Cache of compiled kernels, the folder in which numba keeps them: settled before anything loads numba.

Left alone, numba keeps them beside their sources and looks only at the file that a kernel stands in, not at
those that it calls or takes constants from: once one of these has changed, it would go on using old machine
code. So they are kept in a folder that is named after all sources of the core.

    python -m ogm_services.runtime.kernel_cache COMMAND ...

runs any program that loads kernels in that way.
"""

import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path

import platformdirs
import typer

import ogm_core
from ogm_core.errors import BadSetting, OgmError
from ogm_core.whole_files import NO_ROOM
from ogm_services.runtime.log_lines import tell

VARIABLE = "NUMBA_CACHE_DIR"
LOCATOR_VARIABLE = "NUMBA_CACHE_LOCATOR_CLASSES"
_LOCATOR = "ogm_services.runtime.kernel_files.KernelFiles"
KEPT = 30 * 24 * 3600.0
"""Kernels of other sources are removed if nobody has used them for so long, s."""
_CORE = Path(ogm_core.__file__).parent
_COMPILERS = ("numba", "llvmlite")
_TEMPORARY = "ogm-kernels-"
_LOCK = "in-use"


class NoKernelCache(OgmError):
    """There is no folder at all in which compiled kernels can be kept."""

    slug = "no-kernel-cache"


@contextmanager
def kernel_cache() -> Iterator[Path]:
    """Inside, numba has a folder for compiled kernels, and so have the processes that are started there.

    It is named after these sources, and lies in NUMBA_CACHE_DIR, if set, or else in the user's cache folder.
    If that cannot be written it is a temporary folder: a fresh one, private to this user, because what numba
    reads from its cache it executes.

    Raises:
        BadSetting: NUMBA_CACHE_DIR cannot be written, though there is room on its disk.
        NoKernelCache: nor can any temporary folder.
    """
    given = os.environ.get(VARIABLE)
    parent = Path(given) if given else _place_of_user()
    own = name_of_sources()
    folder = parent if parent.name == own else parent / own  # the former in a process that ogm has started
    fault = _fault(folder)
    if fault is None:
        with _in_use(folder), _numba_uses(folder):
            yield folder
    elif given and fault.errno not in NO_ROOM:
        raise BadSetting(
            f"{VARIABLE} {given}: cannot be written: {fault.strerror or fault}; give a folder for compiled "
            "kernels, or unset it"
        )
    else:
        with _temporary() as place, _numba_uses(place / own):
            tell(
                f"{parent} cannot be written: kernels are compiled at every start, which takes longer; "
                f"set {VARIABLE} to a folder that lasts"
            )
            yield place / own


def begins_empty() -> bool:
    """Whether the folder that numba is told holds no kernel yet."""
    folder = os.environ.get(VARIABLE, "")
    return folder != "" and next(Path(folder).rglob("*.nbi"), None) is None


def lasts() -> bool:
    """Whether later starts find what is compiled now."""
    return not Path(os.environ.get(VARIABLE, "")).parent.name.startswith(_TEMPORARY)


def _place_of_user() -> Path:
    try:
        place = platformdirs.user_cache_path("zenoh-ogm", appauthor=False)
    except RuntimeError:  # the user has no home; older versions return what `_fault` refuses
        place = Path("~/.cache/zenoh-ogm")
    return place / "kernels"


@contextmanager
def _in_use(folder: Path) -> Iterator[None]:
    """Mark a folder as used: its time tells when, and a shared lock that somebody still does."""
    new = not (folder / _LOCK).exists()
    with (folder / _LOCK).open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        os.utime(folder)
        if new:
            _remove_old(folder)
        yield


def _remove_old(new: Path) -> None:
    """Remove the kernels of other sources that nobody uses, nor has used for long."""
    for folder in new.parent.iterdir():
        if folder == new or not re.fullmatch("ogm-[0-9a-f]{16}", folder.name):
            continue
        with suppress(OSError):  # another process was faster, or it is not ours: no harm either way
            if time.time() - folder.stat().st_mtime < KEPT:
                continue
            with (folder / _LOCK).open("a") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder)


@contextmanager
def _temporary() -> Iterator[Path]:
    try:
        folder = tempfile.TemporaryDirectory(prefix=_TEMPORARY, ignore_cleanup_errors=True)
    except OSError as error:
        raise NoKernelCache(
            f"compiled kernels can be kept nowhere, not even in a temporary folder: {error.strerror}; "
            f"set {VARIABLE} to a folder that can be written"
        ) from error
    with folder as path:
        yield Path(path)


@contextmanager
def _numba_uses(folder: Path) -> Iterator[None]:
    ours = {VARIABLE: str(folder), LOCATOR_VARIABLE: _LOCATOR}
    before = {name: os.environ[name] for name in ours if name in os.environ}
    os.environ.update(ours)
    try:
        yield
    finally:
        for name in ours:
            del os.environ[name]
        os.environ.update(before)


def name_of_sources() -> str:
    """Name that changes with any source of the core, and with the compiler.

    numba itself tells Python's versions and processors apart; its own versions only so that one takes the
    place of the other.
    """
    digest = hashlib.sha256(" ".join(map(version, _COMPILERS)).encode())
    for source in sorted(_CORE.rglob("*.py")):
        digest.update(f"{source.relative_to(_CORE)}\0".encode() + source.read_bytes())
    return f"ogm-{digest.hexdigest()[:16]}"


def _fault(folder: Path) -> OSError | None:
    """What keeps numba from using a folder, made if need be; looked for as numba does."""
    if folder.parts[:1] == ("~",):
        return FileNotFoundError("the user has no home")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return error
    return None


def main(command: list[str]) -> int:
    """Run a command, and return its exit code."""
    if not command:
        typer.echo(
            "ogm: a command is needed: python -m ogm_services.runtime.kernel_cache COMMAND ...", err=True
        )
        return 2
    try:
        with kernel_cache():
            return subprocess.run(command, check=False).returncode
    except (OgmError, OSError) as error:
        typer.echo(f"ogm: {error}", err=True)
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
