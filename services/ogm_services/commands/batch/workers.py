"""Worker processes of this machine: they run tasks, and what one that died left is done again.

Who owns what: the thread that calls `run` starts the processes, feeds them and ends them; there is no other.
Each process has a connection of its own and one task at a time, so it is known which task it has died of.
(Python's ProcessPoolExecutor does not tell, and before 3.13 may wait for ever where a process dies while the
next task is handed over.) Whatever ends that thread's work, an error or a signal, kills the processes: what
they were at is of no use to anybody. One whose parent is no more ends by itself.
"""

import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for
from types import TracebackType
from typing import Any, NamedTuple, Protocol, Self, cast

from ogm_core.errors import BadInput, OgmError
from ogm_services.commands.batch.tasks import Task, run_task
from ogm_services.runtime.progress import progress_bar
from ogm_services.runtime.signals import held_signals

MOST_DEATHS = 3
"""So many workers may a task cost, at most."""
ENDS_WITHIN = 10.0
"""How long processes without work may take to end, s; then they are killed."""
_PROCESSES = multiprocessing.get_context("spawn")  # not by fork: numba and our threads would not survive it
_TRACKER: Any = resource_tracker._resource_tracker  # noqa: SLF001
_OF_THE_GROUP = signal.SIGINT, signal.SIGHUP
"""Signals that a terminal sends to the whole group: the parent's to handle."""


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

    def note(self, number: int, result: Any) -> None:  # noqa: ANN401 - whatever the task gave
        """Note what a task gave."""
        self.results[number] = result

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


class _Gave(NamedTuple):
    """What a task gave, or the error that ended it."""

    result: Any
    error: BaseException | None = None


class _Worker:
    """A process that runs a task at a time, and the connection to it."""

    def __init__(self) -> None:
        resource_tracker.ensure_running()  # it would let signals through
        self.connection, theirs = _PROCESSES.Pipe()
        with theirs:  # open in the process alone: when it dies the connection ends
            self._process = _PROCESSES.Process(target=_work, args=(theirs,), daemon=True)
            with _blocked(_OF_THE_GROUP):
                self._process.start()

    @property
    def alive(self) -> bool:
        """Whether the process runs."""
        return self._process.is_alive()

    def end(self) -> None:
        """Tell the process, which has no work, to end."""
        self.connection.close()

    def ended(self, by: float) -> None:
        """Wait until it has, which a frozen one never will: at this monotonic time, s, it is killed."""
        self._process.join(max(0.0, by - time.monotonic()))
        self.kill()

    def kill(self) -> None:
        """End the process, whatever it is at."""
        self.connection.close()
        self._process.kill()
        self._process.join()


class WorkerProcesses(Workers):
    """Tasks are run by so many processes at the same time."""

    def __init__(self, count: int) -> None:
        """Start none before there is a task."""
        self.count = count
        self._idle: list[_Worker] = []
        self._busy: dict[Connection, tuple[_Worker, int]] = {}
        """Who runs the task of which number, by the connection."""
        self._tracked = _TRACKER._pid is None  # noqa: SLF001 - nobody else's children need it

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with held_signals():  # Python waits at its end for whoever is left, a frozen one for ever
            for worker, _ in self._busy.values():
                worker.kill()
            for worker in self._idle:
                worker.end()
            by = time.monotonic() + (ENDS_WITHIN if kind is None else 0.0)
            for worker in self._idle:
                worker.ended(by)
            if self._tracked:
                # Python's helper process would end with this one, but a moment later.
                _TRACKER._stop()  # noqa: SLF001

    def run(self, text: str, tasks: Sequence[Task]) -> list[Any]:
        """See `Workers.run`."""
        outcomes, waiting, deaths = Outcomes(len(tasks)), deque(range(len(tasks))), Counter[int]()
        with progress_bar(text, len(tasks), counted=True) as show:
            while waiting or self._busy:
                while waiting and len(self._busy) < self._most(waiting[0], deaths):
                    number = waiting.popleft()
                    self._begin(number, tasks[number])
                for number, gave in self._ended():
                    deaths[number] += gave is None
                    if gave is None and deaths[number] < MOST_DEATHS:
                        waiting.appendleft(number)
                    elif gave is None:
                        outcomes.fail(number, _died_of(tasks[number]))
                    elif gave.error is not None:
                        outcomes.fail(number, gave.error)
                    else:
                        outcomes.note(number, gave.result)
                waiting = deque(filter(outcomes.matters, waiting))
                self._drop(outcomes)
                show(len(outcomes.results))
            return outcomes.in_order()

    def _most(self, number: int, deaths: Counter[int]) -> int:
        """So many tasks may run beside this one and with it: what a worker died of is done again alone."""
        running = (number for _, number in self._busy.values())
        return 1 if any(deaths[one] for one in (number, *running)) else self.count

    def _begin(self, number: int, task: Task) -> None:
        """Hand a task to a process that has none, or to a new one."""
        with held_signals():  # one that is begun by half complains, and nobody would know of it
            worker = self._one_idle() or self._one_more()
            self._busy[worker.connection] = worker, number
        with suppress(OSError):  # it has just died: its connection says so
            worker.connection.send(task)

    def _one_idle(self) -> _Worker | None:
        while self._idle:
            worker = self._idle.pop()
            if worker.alive:
                return worker
            worker.kill()  # it died without work, which no task is to blame for
        return None

    def _one_more(self) -> _Worker:
        try:
            return _Worker()
        except OSError as error:
            at_work = len(self._busy)
            raise BadInput(
                f"--workers {self.count}: beside {at_work} processes no other can be started: "
                f"{error.strerror}: ask for fewer, or raise the limit (ulimit -a)"
            ) from error

    def _ended(self) -> Iterator[tuple[int, _Gave | None]]:
        """Wait until a task has ended; the numbers of those that have, and what they gave; None: a death."""
        for connection in cast(list[Connection], wait_for(list(self._busy))):
            worker, number = self._busy[connection]
            try:
                gave = connection.recv()
            except (EOFError, OSError):
                worker.kill()
                gave = None
            else:
                self._idle.append(worker)
            del self._busy[connection]
            yield number, gave

    def _drop(self, outcomes: Outcomes) -> None:
        """Kill who is at a task that does not matter any more."""
        for connection, (worker, number) in list(self._busy.items()):
            if not outcomes.matters(number):
                worker.kill()
                del self._busy[connection]


def _died_of(task: Task) -> WorkerDied:
    why = f"{MOST_DEATHS} workers have died of it: is there no memory left? Fewer --workers need less"
    return WorkerDied(f"{task.about}: {why}")


def _work(connection: Connection) -> None:
    """Run the tasks that come, in a process of its own, until the connection ends."""
    for number in _OF_THE_GROUP:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _OF_THE_GROUP)
    threading.Thread(target=_end_with_parent, name="ogm-parent", daemon=True).start()
    with suppress(EOFError, OSError):  # the parent has closed it, or is gone
        while True:
            task = connection.recv()
            try:
                connection.send(_Gave(run_task(task)))
            except Exception as error:  # noqa: BLE001 - the parent's to raise
                if not isinstance(error, OgmError):
                    error.add_note(traceback.format_exc())  # where in this process
                connection.send(_Gave(None, _sendable(error)))


def _sendable(error: Exception) -> Exception:
    """An error that the parent can read: this one, or its text where pickle cannot make it anew."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # noqa: BLE001 - whatever the error's class raises
        text = RuntimeError(f"{type(error).__name__}: {error}")
        text.__notes__ = [str(note) for note in getattr(error, "__notes__", ())]
        return text
    return error


@contextmanager
def _blocked(signals: Iterable[signal.Signals]) -> Iterator[None]:
    """Inside, signals wait: also those to a process that is started here, until it lets them come."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        os._exit(1)
