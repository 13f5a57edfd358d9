"""Worker processes of this machine: they run tasks, and what one that died left is done again.

Who owns what: the executor starts and feeds the processes, all from the thread that calls `run`. Whatever
ends that thread's work, an error or a signal, kills them: what they were at is of no use to anybody. A worker
ends by itself once its parent is no more.
"""

import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from contextlib import AbstractContextManager
from multiprocessing import resource_tracker
from multiprocessing.connection import wait as wait_for
from types import TracebackType
from typing import Any, Protocol, Self

from ogm_core.errors import OgmError
from ogm_services.commands.batch.tasks import Task, run_task
from ogm_services.runtime.progress import progress_bar

MOST_DEATHS = 3
"""So many workers may a task cost, at most."""
_TRACKER: Any = resource_tracker._resource_tracker  # noqa: SLF001


class WorkerDied(OgmError):
    """Whoever works at a task dies of it, time and again."""

    slug = "worker-died"


class Workers(AbstractContextManager["Workers"], Protocol):
    """Who runs tasks. Used in a `with`."""

    count: int
    """How many tasks are run at the same time."""
    elsewhere: bool = False
    """Whether a relative path may mean another file to them."""

    def run(self, text: str, tasks: Sequence[Task]) -> list[Any]:
        """Run tasks in any order, and return what each gave, in theirs; `text` names them all.

        Raises:
            OgmError: a task did, the first in their order, whichever failed first; or WorkerDied.
        """


class Outcomes:
    """What tasks gave, by their numbers, and which is the first that failed: nothing after it matters."""

    def __init__(self, count: int) -> None:
        self.results: dict[int, Any] = {}
        self._count = count
        self._failure: BaseException | None = None

    def note(self, number: int, future: "Future[Any]") -> None:
        """Note what a task gave whose future has ended."""
        error = future.exception()
        if error is None:
            self.results[number] = future.result()
        else:
            self.fail(number, error)

    def fail(self, number: int, error: BaseException) -> None:
        """Note that a task failed."""
        if self.matters(number):
            self._count, self._failure = number, error

    def matters(self, number: int) -> bool:
        """Whether a task comes before the first that failed."""
        return number < self._count

    def in_order(self) -> list[Any]:
        """All results, once every task that matters has ended; raises what the first failed by."""
        if self._failure is not None:
            raise self._failure
        return [self.results[number] for number in range(self._count)]


class WorkerProcesses(Workers):
    """Tasks are run by so many processes at the same time."""

    def __init__(self, count: int) -> None:
        """Start none before there is a task."""
        self.count = count
        self._others = set(multiprocessing.active_children())
        self._tracked = _TRACKER._pid is None  # noqa: SLF001 - nobody else's children need it
        self._executor = self._new()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._kill()
        self._executor.shutdown(wait=True, cancel_futures=True)
        if self._tracked:
            # Python's helper process would end with this one, but a moment later.
            _TRACKER._stop()  # noqa: SLF001

    def run(self, text: str, tasks: Sequence[Task]) -> list[Any]:
        """See `Workers.run`."""
        with progress_bar(text, len(tasks), counted=True) as show:
            run = _Run(tasks)
            while run.left:
                while (number := run.next(self.count)) is not None:
                    run.running[self._begin(tasks[number])] = number
                run.collect()
                if run.broken:
                    self._renew()
                show(len(run.outcomes.results))
            return run.outcomes.in_order()

    def _begin(self, task: Task) -> "Future[Any]":
        try:
            return self._executor.submit(run_task, task)
        except BrokenExecutor:  # a worker died that had nothing to do
            self._renew()
            return self._executor.submit(run_task, task)

    def _new(self) -> ProcessPoolExecutor:
        # Not by fork: numba and our threads would not survive it.
        context = multiprocessing.get_context("spawn")
        return ProcessPoolExecutor(self.count, mp_context=context, initializer=_begin_worker)

    def _renew(self) -> None:
        self._executor.shutdown(wait=True, cancel_futures=True)
        self._executor = self._new()

    def _kill(self) -> None:
        for process in set(multiprocessing.active_children()) - self._others:
            process.kill()


class _Run:
    """Which tasks are still to be run, are running, and are done.

    Of tasks that ran when a worker died nobody knows which it was that killed it: each is run again alone.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        self.outcomes = Outcomes(len(tasks))
        self.running: dict[Future[Any], int] = {}
        self.broken = False
        self._tasks = tasks
        self._waiting = deque(range(len(tasks)))
        self._suspects: deque[int] = deque()
        self._alone = False
        self._deaths: Counter[int] = Counter()

    @property
    def left(self) -> bool:
        """Whether a task that matters has not ended."""
        return any((self.running, self._waiting, self._suspects))

    def next(self, most: int) -> int | None:
        """The number of a task that is to begin now, if `most` may run; None: none is."""
        if not self.running:
            self._alone = bool(self._suspects)
            if self._suspects:
                return self._suspects.popleft()
        if self._alone or not self._waiting or len(self.running) >= most:
            return None
        return self._waiting.popleft()

    def collect(self) -> None:
        """Wait until a task has ended, and note what it gave; see whether workers died."""
        done, _ = wait(self.running, return_when=FIRST_COMPLETED)
        self.broken = any(isinstance(future.exception(), BrokenExecutor) for future in done)
        if self.broken:
            done, _ = wait(self.running)  # all end, by the same error
        dead = []
        for future in done:
            number = self.running.pop(future)
            if isinstance(future.exception(), BrokenExecutor):
                dead.append(number)
            else:
                self.outcomes.note(number, future)
        for number in sorted(dead):
            self._died(number)
        matters = self.outcomes.matters
        self.running = {future: number for future, number in self.running.items() if matters(number)}
        self._waiting = deque(filter(matters, self._waiting))
        self._suspects = deque(filter(matters, self._suspects))

    def _died(self, number: int) -> None:
        """Note that a task may have killed its worker."""
        self._deaths[number] += 1
        if self._deaths[number] < MOST_DEATHS:
            self._suspects.append(number)
            return
        why = (
            f"{self._tasks[number].about}: {MOST_DEATHS} workers have died of it: is there no memory left? "
            "Fewer --workers need less"
        )
        self.outcomes.fail(number, WorkerDied(why))


def _begin_worker() -> None:
    """In a worker: signals to the whole group are the parent's to handle, and without it there is no work."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, name="ogm-parent", daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)
