"""Output to a terminal that may be gone: no reason to lose the map."""

import errno
import io
import sys
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_TERMINAL_GONE = frozenset({errno.EIO})
_READER_GONE = frozenset({errno.EPIPE})


def outlive_terminal() -> None:
    """From here on, to the end of the process, nothing fails because its terminal was closed.

    What is printed then goes nowhere, and so does what is printed on stderr to a pipe that nobody reads. On
    stdout such a pipe stays an error: whoever read a result there wants no more of it. What the terminal's
    encoding has no character for, such as file names that are no text, is printed in escapes.
    """
    sys.stdout = _outliving(sys.stdout, _TERMINAL_GONE)
    sys.stderr = _outliving(sys.stderr, _TERMINAL_GONE | _READER_GONE)


def _outliving(stream: TextIO, forgiven: frozenset[int]) -> TextIO:
    if not isinstance(stream, io.TextIOWrapper):  # None, where there is no such stream at all
        return stream
    # Not by catching errors where something is printed: logging, progress bars and the interpreter's own end
    # print as well, and what a buffer could not get rid of, it tries again.
    return io.TextIOWrapper(
        io.BufferedWriter(_Outliving(stream.fileno(), forgiven)),
        encoding=stream.encoding,
        errors="backslashreplace" if stream.errors == "strict" else stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


class _Outliving(io.FileIO):
    """A descriptor, which stays open; what it refuses for a reason that is forgiven counts as written."""

    def __init__(self, descriptor: int, forgiven: frozenset[int]) -> None:
        super().__init__(descriptor, "w", closefd=False)
        self._forgiven = forgiven

    def write(self, data: "ReadableBuffer", /) -> int:
        """Write bytes, or drop them; how many they were."""
        try:
            return super().write(data)
        except OSError as error:
            if error.errno not in self._forgiven:
                raise
            return memoryview(data).nbytes
