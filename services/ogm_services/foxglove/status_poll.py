"""Status poll: what a mapper says of its robots, asked again and again; whether it answers at all."""

import threading
from collections.abc import Callable

from ogm_client import MapClient
from ogm_client.errors import CannotConnect, ClientError, NobodyAnswered
from ogm_core.status import RobotStatus

_CLOSING = 2.0


class StatusPoll:
    """A thread that asks for the status every `period` seconds."""

    def __init__(self, client: MapClient, where: str, period: float, trouble: Callable[[str], None]) -> None:
        """`where` the mapper is; `trouble` is told, by the thread, what is wrong, "" when it is well."""
        self._client = client
        self._where = where
        self._period = period
        self._trouble = trouble
        self._newest: dict[str, RobotStatus] | None = None
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="foxglove-status", daemon=True)
        self._thread.start()

    def take(self) -> dict[str, RobotStatus] | None:
        """What is said of the robots; None if nothing new was since this was called last."""
        newest, self._newest = self._newest, None
        return newest

    def close(self) -> None:
        """Ask no more."""
        self._ending.set()
        self._thread.join(_CLOSING)

    def _run(self) -> None:
        while not self._ending.is_set():
            try:
                self._newest = self._client.status().robots
            except (CannotConnect, NobodyAnswered):
                if not self._ending.is_set():
                    self._trouble(f"no mapper answers at {self._where}, trying again")
            except ClientError as error:
                if not self._ending.is_set():
                    self._trouble(str(error))
            else:
                self._trouble("")
            self._ending.wait(self._period)
