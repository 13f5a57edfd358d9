"""Service manager, systemd as a rule, that is told how the process it has started gets on (sd_notify)."""

import logging
import os
import socket
from collections.abc import MutableMapping

PATIENCE = 1.0
"""How long a notice may wait for a service manager that reads none, s."""

log = logging.getLogger(__name__)


class ServiceManager:
    """Who listens on the datagram socket that NOTIFY_SOCKET names; without it nobody is told. Any thread."""

    def __init__(self, environ: MutableMapping[str, str] = os.environ) -> None:
        """Take the variables that are meant for this process alone out of the environment."""
        self._name = environ.pop("NOTIFY_SOCKET", "")
        period = environ.pop("WATCHDOG_USEC", "")
        meant = environ.pop("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._watches = meant and period.isdecimal() and int(period) > 0
        self._up = False

    def ready(self, status: str) -> None:
        """The service is up; `status` is one line for people."""
        self._tell(f"READY=1\nSTATUS={status}")
        self._up = True

    def stopping(self, status: str) -> None:
        """It has begun to stop."""
        self._tell(f"STOPPING=1\nSTATUS={status}")

    def alive(self) -> None:
        """It works, once it is up. Who watches it (WatchdogSec) starts a silent one again."""
        if self._watches and self._up:
            self._tell("WATCHDOG=1")

    def _tell(self, notice: str) -> None:
        if not self._name:
            return
        name = f"\0{self._name[1:]}" if self._name.startswith("@") else self._name  # "@": an abstract name
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as telling:
                telling.settimeout(PATIENCE)
                telling.sendto(notice.encode(), name)
        except OSError as error:
            log.warning("NOTIFY_SOCKET %s: %r is not told: %s", self._name, notice, error)
