"""Workers of a Dask cluster: they run the same tasks, on machines that read and write the same disk.

Dask itself does again what a worker that died has left, and gives up a task that several have died of. But it
waits without a word, and without an end, where no worker takes a task: one that uses most of its memory limit
is paused, and Python seldom gives memory back. Loads `distributed`, which is the extra `dask`, when it is
asked for.
"""

import socket
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from functools import partial
from types import TracebackType
from typing import Any, Self

from ogm_core.errors import BadInput, MissingExtra, OgmError
from ogm_services.commands.batch.tasks import Task, run_task_of
from ogm_services.commands.batch.workers import MOST_DEATHS, Outcomes, WorkerDied, Workers
from ogm_services.runtime.kernel_cache import name_of_sources
from ogm_services.runtime.progress import progress_bar

CONNECTED_WITHIN = 30
"""How long a scheduler may take to answer, s."""
STALLED_FOR = 60.0
"""How long all workers may be without work though there is some, s."""
LOOKED_AT = 2.0
"""How often it is looked whether they are, s."""


class ClusterFailed(OgmError):
    """A Dask cluster does no more work."""

    slug = "cluster-failed"


class DaskWorkers(Workers):
    """The workers that a scheduler has when the build begins."""

    elsewhere = True

    def __init__(self, address: str) -> None:
        """Connect to the scheduler.

        Raises:
            MissingExtra: Dask is not installed.
            BadInput: none answers there, or it has no worker.
        """
        try:
            from distributed import Client
            from distributed.comm.addressing import parse_address, parse_host_port
        except ImportError as error:
            raise MissingExtra("--dask needs distributed: pip install 'zenoh-ogm[dask]'") from error
        try:
            # Before a client is made: one tries on where nobody listens, and takes a minute to be let go of.
            host = parse_host_port(parse_address(address)[1])
            socket.create_connection(host, timeout=CONNECTED_WITHIN).close()
            self._client = Client(address, timeout=CONNECTED_WITHIN, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise BadInput(f"--dask {address}: no scheduler answers there: {error}") from error
        self.count = sum(self._client.nthreads().values())
        if not self.count:
            self._client.close()
            raise BadInput(f"--dask {address}: the scheduler has no worker: start some, then build")
        self._address = address
        self._executor = self._client.get_executor(pure=False, retries=MOST_DEATHS - 1)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._executor.shutdown(wait=kind is None)
        self._client.close()

    def run(self, text: str, tasks: Sequence[Task]) -> list[Any]:
        """See `workers.Workers.run`."""
        run = partial(run_task_of, name_of_sources())
        outcomes, worked = Outcomes(len(tasks)), time.monotonic()
        with progress_bar(text, len(tasks), counted=True) as show:
            numbers = {self._executor.submit(run, task): number for number, task in enumerate(tasks)}
            left = set(numbers)
            while left:
                done, _ = wait(left, timeout=LOOKED_AT, return_when=FIRST_COMPLETED)
                for future in done:
                    self._note(outcomes, numbers[future], future, tasks)
                left = {future for future in left - done if outcomes.matters(numbers[future])}
                show(len(outcomes.results))
                if done or self._at_work():
                    worked = time.monotonic()
                elif time.monotonic() - worked > STALLED_FOR:
                    raise ClusterFailed(f"--dask {self._address}: {self._stall()}")
            return outcomes.in_order()

    def _note(self, outcomes: Outcomes, number: int, future: "Future[Any]", tasks: Sequence[Task]) -> None:
        """Note what a task gave, or what kept it from that, in our words.

        Raises:
            ClusterFailed: the scheduler is gone.
        """
        from distributed import KilledWorker

        if future.cancelled():
            raise ClusterFailed(f"--dask {self._address}: the scheduler is gone: start it, then build again")
        match future.exception():
            case KilledWorker():
                why = f"{MOST_DEATHS} workers of --dask have died of it: is there no memory left?"
                outcomes.fail(number, WorkerDied(f"{tasks[number].about}: {why}"))
            case ModuleNotFoundError() as error:
                why = f"--dask: {error} at a worker: install zenoh-ogm in the workers' environment"
                outcomes.fail(number, BadInput(why))
            case None:
                outcomes.note(number, future.result())
            case error:
                outcomes.fail(number, error)

    def _workers(self) -> list[dict[str, Any]]:
        """What the scheduler knows of each worker."""
        return list(self._client.scheduler_info(n_workers=-1)["workers"].values())

    def _at_work(self) -> bool:
        try:
            return any(worker["metrics"]["task_counts"].get("executing") for worker in self._workers())
        except OSError:  # the scheduler is gone, or too busy to tell
            return False

    def _stall(self) -> str:
        """Why nobody works, and what to do."""
        workers = self._workers()
        paused = sum(worker["status"] == "paused" for worker in workers)
        if not workers:
            return (
                f"it has had no worker for {STALLED_FOR:.0f} s: start some, then build again; if they "
                "ended at the first task, zenoh-ogm is not installed in their environment: see a worker's log"
            )
        if not paused:
            return f"no worker has taken a task for {STALLED_FOR:.0f} s: look at the scheduler's log"
        return (
            f"{paused} of {len(workers)} workers are paused, as they use most of the memory that they may: "
            "give each more (dask worker --memory-limit), then build again"
        )
