"""Lines of a log, none of which is ever read as a whole if it is longer than any message."""

from collections.abc import Iterator
from typing import IO

_BYTES_A_BEAM = 24
"""A range as text, and what is between it and the next one."""
_BESIDES = 4096
_AT_ONCE = 64 * 1024


class LongLine(bytes):
    """In place of a line that was too long to be read."""

    __slots__ = ()


def longest_line(max_beams: int) -> int:
    """The longest line of a scan of up to `max_beams` beams, bytes."""
    return _BYTES_A_BEAM * max_beams + _BESIDES


def lines_of(file: IO[bytes], longest: int) -> Iterator[bytes]:
    """Every line of a file with its end, or an empty LongLine if it is of more than `longest` bytes."""
    while line := file.readline(longest + 1):
        if len(line) <= longest:
            yield line
            continue
        while not line.endswith(b"\n") and (more := file.readline(_AT_ONCE)):
            line = more
        yield LongLine()
