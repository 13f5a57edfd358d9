"""`ogm`, which is also `python -m ogm_services`: the command line, unless its files may be another's."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager


def main() -> None:
    """Run the program.

    Not beside zenoh-ogm-client, whose files have the same names: whichever was installed last has written
    them, maybe those of another version. So nothing else of the project is loaded before this is known.
    """
    with _quiet_interrupt():
        beside_another = _installed("zenoh-ogm-client")
    if beside_another:
        sys.exit(
            "ogm: zenoh-ogm and zenoh-ogm-client are both installed and overwrite each other's files: "
            "run `pip uninstall zenoh-ogm zenoh-ogm-client`, then install one of the two"
        )
    with _quiet_interrupt():
        from ogm_services import cli

    cli.main()


@contextmanager
def _quiet_interrupt() -> Iterator[None]:
    """Ctrl-C inside ends the process at once, without a traceback: nothing runs that has to end in order."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield  # ignored, as of what a shell has put into the background
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _installed(distribution: str) -> bool:
    from importlib.metadata import PackageNotFoundError, version  # here, where Ctrl-C is quiet

    try:
        version(distribution)
    except PackageNotFoundError:
        return False
    return True


if __name__ == "__main__":
    main()
