"""Start of a service that a signal ends in bounded time, whatever the main thread is in."""

import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from ogm_services.runtime.bounded_close import what_holds


@contextmanager
def ended_within(seconds: float, end: Callable[[str], None]) -> Iterator[None]:
    """Call `end`, with what holds the main thread, if that is still inside `seconds` after a signal.

    Python's own handlers run between two steps of the main thread, which may be in a library that makes none,
    or that swallows what they raise: so a thread hears of signals at once. A KeyboardInterrupt that was
    swallowed is raised again at the end. Elsewhere than in the main thread this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard, told = socket.socketpair()
    told.setblocking(False)
    came, left = threading.Event(), threading.Event()

    def watch() -> None:
        if not heard.recv(1):  # closed: no signal came
            return
        came.set()
        if not left.wait(seconds):
            end(what_holds(threading.main_thread()))

    # A daemon: it keeps no process from ending.
    watching = threading.Thread(target=watch, name="ogm-start-watch", daemon=True)
    watching.start()
    before = signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)
    try:
        yield
    finally:
        left.set()
        signal.set_wakeup_fd(before)
        told.close()
        watching.join()
        heard.close()
    if came.is_set():
        raise KeyboardInterrupt
