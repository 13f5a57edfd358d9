"""A task as a worker begins it, wherever that runs: it loads what it needs once it is settled where from."""

import threading
from contextlib import ExitStack
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from ogm_core.errors import BadInput
from ogm_services.runtime.kernel_cache import kernel_cache, name_of_sources
from ogm_services.runtime.log_lines import log_nothing
from ogm_services.runtime.progress import nothing_shown

_for_life = ExitStack()
_settling = threading.Lock()


class Task(NamedTuple):
    """A function, by its name and its module's, and its arguments; `about`: what it works at, in words."""

    name: str
    arguments: tuple[Any, ...]
    about: str
    module: str = "ogm_services.commands.batch.work"


def run_task(task: Task) -> Any:  # noqa: ANN401 - whatever the function returns
    """Run a task in this thread, without a word.

    Raises:
        OgmError: as its function.
    """
    with _settling:  # threads of a worker begin their first tasks at once
        _settle_kernels()
    with nothing_shown(), log_nothing():
        return getattr(import_module(task.module), task.name)(*task.arguments)


def run_task_of(sources: str, task: Task) -> Any:  # noqa: ANN401 - whatever the function returns
    """Run a task of a build that was begun by `sources` (see `name_of_sources`): others might map otherwise.

    Raises:
        BadInput: those of this process are others.
    """
    if name_of_sources() != sources:
        raise BadInput(
            "--dask: a worker has another version of zenoh-ogm, or of numba: install the same everywhere"
        )
    return run_task(task)


@cache
def _settle_kernels() -> None:
    """Give compiled kernels their place for this process's life, before anything loads numba."""
    _for_life.enter_context(kernel_cache())
