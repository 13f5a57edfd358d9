"""Where numba keeps compiled kernels: settled before anything loads numba.

Left alone, numba takes `__pycache__` beside a kernel's source, else the user's cache folder, and fails with a
traceback where neither can be written, as in a read-only container whose user has no home.
"""

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

import ogm_core
from ogm_core.errors import BadSetting, OgmError

VARIABLE = "NUMBA_CACHE_DIR"
_CORE = Path(ogm_core.__file__).parent


class NoKernelCache(OgmError):
    """There is no folder at all in which compiled kernels can be kept."""

    slug = "no-kernel-cache"


@contextmanager
def kernel_cache() -> Iterator[None]:
    """Inside, numba has a folder for compiled kernels, and so have the processes that are started there.

    NUMBA_CACHE_DIR, if set, gets a subfolder for these sources. Else numba is left alone if it finds a folder
    by itself. Else there is a temporary folder: a fresh one, private to this user, because what numba reads
    from its cache it executes.

    Raises:
        BadSetting: NUMBA_CACHE_DIR cannot be written.
        NoKernelCache: nor can any temporary folder.
    """
    given = os.environ.get(VARIABLE)
    if given:
        with _numba_uses(_lasting(Path(given))):
            yield
    elif any(place.is_absolute() and _fault(place) is None for place in _places_of_numba()):
        yield
    else:
        with _temporary() as folder, _numba_uses(folder / _of_these_sources()):
            places = " nor ".join(map(str, _places_of_numba()))
            typer.echo(
                f"ogm: neither {places} can be written: kernels are compiled at every start, which takes "
                f"longer; set {VARIABLE} to a folder that lasts",
                err=True,
            )
            yield


def _lasting(given: Path) -> Path:
    own = _of_these_sources()
    folder = given if given.name == own else given / own  # the former in a process that ogm has started
    fault = _fault(folder)
    if fault is not None:
        raise BadSetting(
            f"{VARIABLE} {given}: cannot be written: {fault.strerror or fault}; give a folder for compiled "
            "kernels, or unset it"
        )
    return folder


@contextmanager
def _temporary() -> Iterator[Path]:
    try:
        folder = tempfile.TemporaryDirectory(prefix="ogm-kernels-", ignore_cleanup_errors=True)
    except OSError as error:
        raise NoKernelCache(
            f"compiled kernels can be kept nowhere, not even in a temporary folder: {error.strerror}; "
            f"set {VARIABLE} to a folder that can be written"
        ) from error
    with folder as path:
        yield Path(path)


@contextmanager
def _numba_uses(folder: Path) -> Iterator[None]:
    before = os.environ.get(VARIABLE)
    os.environ[VARIABLE] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ[VARIABLE]
        else:
            os.environ[VARIABLE] = before


def _of_these_sources() -> str:
    """Name that changes with any source of the core.

    numba looks only at the file that a kernel stands in, not at those that it calls or takes constants from:
    in a folder that outlasts an upgrade it would go on using old machine code.
    """
    digest = hashlib.sha256()
    for source in sorted(_CORE.rglob("*.py")):
        digest.update(f"{source.relative_to(_CORE)}\0".encode() + source.read_bytes())
    return f"ogm-{digest.hexdigest()[:16]}"


def _places_of_numba() -> tuple[Path, Path]:
    """Where numba looks by itself, in its order."""
    # Path.expanduser raises where a user has no home; numba then takes a folder named "~".
    cache = os.environ.get("XDG_CACHE_HOME", os.path.expanduser("~/.cache"))  # noqa: PTH111
    return _CORE / "__pycache__", Path(cache, "numba")


def _fault(folder: Path) -> OSError | None:
    """What keeps numba from using a folder, made if need be; looked for as numba does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        return error
    return None
