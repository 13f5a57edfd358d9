"""Heads of messages: stamp, seq and run, read without the rest, by whoever has a microsecond for it."""

from functools import lru_cache

from ogm_core.errors import BadMessage
from ogm_core.wire.keys import NAME
from ogm_core.wire.messages import INT_END, numbering

Head = tuple[int, int, str]
"""What numbers a message: its stamp in ns, its seq among those of its key and run, and the run."""


def read_head(payload: bytes) -> Head | None:
    """The head of a pose or scan message; None of what has none, which no decoder takes.

    The rest is not looked at. Our publishers' messages begin with stamp, seq and run in this order, and are
    read in place; others are unpacked whole, which takes a few times as long.
    """
    try:
        if payload.startswith(b"\xa5stamp\xcf", 1) and payload.startswith(b"\xa3seq", 16):
            seq, at = payload[20], 21
            if seq >= 0xCC:  # an integer of 1, 2, 4 or 8 bytes follows
                at += 1 << (seq & 3)
                seq = int.from_bytes(payload[21:at])
            if payload.startswith(b"\xa3run", at) and (payload[20] < 0x80 or 0xCC <= payload[20] <= 0xCF):
                length, at = payload[at + 4], at + 5
                if length == 0xD9:  # a text of 32 bytes or more: their number follows
                    length, at = payload[at], at + 1
                elif 0xA0 <= length < 0xC0:
                    length -= 0xA0
                else:
                    return numbering(payload)
                run, stamp = _run_of(payload[at : at + length]), int.from_bytes(payload[8:16])
                if run is not None and stamp < INT_END and seq < INT_END:
                    return stamp, seq, run
        return numbering(payload)
    except (BadMessage, IndexError):
        return None


def numbered_so(payload: bytes, number: bytes) -> bool:
    """Whether a message of our publishers has this seq and run, as `number_of` writes them."""
    return payload.startswith(number, 16) and payload.startswith(b"\xa5stamp\xcf", 1)


def number_of(seq: int, run: str) -> bytes:
    """A seq and a run as they stand in a message of our publishers."""
    if seq < 0x80:
        digits = bytes((seq,))
    elif seq < 2**16:
        digits = b"\xcd" + seq.to_bytes(2) if seq > 0xFF else b"\xcc" + bytes((seq,))
    else:
        digits = b"\xce" + seq.to_bytes(4) if seq < 2**32 else b"\xcf" + seq.to_bytes(8)
    return b"\xa3seq" + digits + _run_field(run)


@lru_cache(4096)
def _run_field(run: str) -> bytes:
    text = run.encode()
    return b"\xa3run" + (bytes((0xA0 + len(text),)) if len(text) < 32 else bytes((0xD9, len(text)))) + text


@lru_cache(4096)
def _run_of(text: bytes) -> str | None:
    """A run's name; None if it is none."""
    run = text.decode("ascii", "replace")
    return run if not run or NAME.fullmatch(run) else None
