"""A disk without room, for this process: a fault that needs nobody's leave."""

import resource
import signal
from contextlib import contextmanager


@contextmanager
def room_for(size):
    """Files may grow to so many bytes, and then there is no room, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
