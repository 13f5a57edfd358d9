"""Workers of a Dask cluster: they run the same tasks, on machines that read and write the same disk.

Dask itself does again what a worker that died has left, and gives up a task that several have died of. Loads
`distributed`, which is the extra `dask`, when it is asked for.
"""

from collections.abc import Sequence
from concurrent.futures import Future, as_completed
from functools import partial
from types import TracebackType
from typing import Any, Self

from ogm_core.errors import BadInput, MissingExtra
from ogm_services.commands.batch.tasks import Task, run_task_of
from ogm_services.commands.batch.workers import MOST_DEATHS, WorkerDied, Workers
from ogm_services.runtime.kernel_cache import name_of_sources
from ogm_services.runtime.progress import progress_bar

CONNECTED_WITHIN = 30
"""How long a scheduler may take to answer, s."""


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
            # Before a client is made: one that was given no port takes a minute to be let go of.
            parse_host_port(parse_address(address)[1])
            self._client = Client(address, timeout=CONNECTED_WITHIN, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise BadInput(f"--dask {address}: no scheduler answers there: {error}") from error
        self.count = sum(self._client.nthreads().values())
        if not self.count:
            self._client.close()
            raise BadInput(f"--dask {address}: the scheduler has no worker: start some, then build")
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
        with progress_bar(text, len(tasks), counted=True) as show:
            numbers = {self._executor.submit(run, task): number for number, task in enumerate(tasks)}
            results: dict[int, Any] = {}
            for future in as_completed(numbers):
                number = numbers[future]
                results[number] = _result(future, tasks[number])
                show(len(results))
        return [results[number] for number in range(len(tasks))]


def _result(future: "Future[Any]", task: Task) -> Any:  # noqa: ANN401 - whatever the task gave
    from distributed import KilledWorker

    try:
        return future.result()
    except KilledWorker as error:
        raise WorkerDied(
            f"{task.about}: {MOST_DEATHS} workers of --dask have died of it: is there no memory left?"
        ) from error
    except ModuleNotFoundError as error:
        raise BadInput(
            f"--dask: {error} at a worker: install zenoh-ogm in the workers' environment"
        ) from error
