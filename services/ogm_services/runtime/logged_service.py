"""What every service runs in: it logs, and ends in order at a signal."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from ogm_services.runtime.log_lines import log_to_stderr
from ogm_services.runtime.signals import running_service


@contextmanager
def logged_service(
    level: Literal["debug", "info", "warning", "error"], form: Literal["text", "json"], interrupted: int = 0
) -> Iterator[None]:
    """What runs inside logs from a level on, in a form, and ends in order at a signal, with `interrupted`."""
    if "RUST_LOG" in os.environ:
        import zenoh

        zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
    with log_to_stderr(level, form), running_service(interrupted):
        yield
