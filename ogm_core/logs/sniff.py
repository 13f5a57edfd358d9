"""What a file is that was given as a log and is none: told from its first bytes and its name.

It is for the user's eyes and says what to do; nothing is read by it.
"""

import re
import zlib
from typing import Literal

from ogm_core.logs.jsonl_writer import JSON_SUFFIXES

HEAD = 4096
"""How many bytes of a file are looked at."""
CARMEN_SUFFIXES = (".log", ".log.gz", ".clf", ".clf.gz")
G2O_SUFFIXES = (".g2o", ".g2o.gz")
READ = (
    f"JSON lines ({', '.join(JSON_SUFFIXES)}), CARMEN ({', '.join(CARMEN_SUFFIXES)}) "
    f"and g2o with laser lines ({', '.join(G2O_SUFFIXES)}), and bags (folders, .db3, .mcap, .bag)"
)
BOM = b"\xef\xbb\xbf"
"""The mark that some programs put before UTF-8 text."""
OF_GRAPH = "give the log that it was made of"

_SEE = "see docs/logs.md"
_CONVERT = f"convert it to JSON lines ({_SEE})"
_BAG = f"unpack it, bags are read as they are ({_SEE})"
"""Of one that is packed; others do not come here."""
_UNPACK = "unpack it, and give the log that is in it"
_GZIP = b"\x1f\x8b"
_SIGNATURES = (
    (b"#ROSBAG V", "a ROS 1 bag", _BAG),
    (b"\x89MCAP0\r\n", "an MCAP file, as of a ROS 2 bag", _BAG),
    (b"SQLite format 3\0", "an SQLite database, as of a ROS 2 bag", _BAG),
    (b"PK\x03\x04", "a zip archive", _UNPACK),
    (b"PK\x05\x06", "an empty zip archive", "give a log"),
    (b"7z\xbc\xaf\x27\x1c", "a 7z archive", _UNPACK),
    (b"\xfd7zXZ\0", "packed with xz", "unpack it, or pack it with gzip"),
    (b"BZh", "packed with bzip2", "unpack it, or pack it with gzip"),
    (b"\x28\xb5\x2f\xfd", "packed with zstd", "unpack it, or pack it with gzip"),
)
_GFS = "GridFastSLAM's output", "make a CARMEN log of it with GMapping's gfs2log"
_GFS_LINE = re.compile(rb"^LASER_READING\s", re.MULTILINE)
_OUR_ARRAY = b"log_odds.npy"
_TAR = (257, b"ustar")  # where a tar archive says that it is one
_NAMES = (
    ((".bag",), "a ROS 1 bag", _BAG),
    ((".mcap",), "an MCAP file, as of a ROS 2 bag", _BAG),
    ((".db3",), "an SQLite database, as of a ROS 2 bag", _BAG),
    ((".npz", ".npy"), "NumPy arrays", _CONVERT),
    ((".rawlog",), "an MRPT rawlog", f"convert it with MRPT's rawlog2carmen, or to JSON lines ({_SEE})"),
    ((".zip", ".7z", ".tar", ".tgz"), "an archive", _UNPACK),
    ((".json",), "a JSON document", f"write it as JSON lines, one message a line ({_SEE})"),
    ((".csv", ".tsv"), "a table", _CONVERT),
)

Kind = Literal["CARMEN", "JSON lines", "JSON", "g2o"]
_KINDS: tuple[tuple[re.Pattern[bytes], Kind], ...] = (
    (re.compile(rb"(?:PARAM|SYNC|ODOM|TRUEPOS|[FR]LASER|(?:RAW|ROBOT)?LASER\d?)\s"), "CARMEN"),
    (re.compile(rb"(?:(?:VERTEX|EDGE|PARAMS)[23_]\S*|FIX)\s"), "g2o"),
    (re.compile(rb'\{.*"type"\s*:\s*"(?:pose|scan)"'), "JSON lines"),
    (re.compile(rb"[{\[]"), "JSON"),
)

_TEXTS: dict[Kind, tuple[str, str]] = {
    "CARMEN": ("a CARMEN log", ".log"),
    "JSON lines": ("JSON lines", ".jsonl"),
    "g2o": ("a g2o pose graph", ".g2o"),
}
"""What is read under its own name, and how that ends."""


def why_not(name: str, head: bytes) -> str | None:
    """Why a file is not read as a log; None if it may be one.

    `name` is the file's, `head` its first `HEAD` bytes as they are on disk.
    """
    if not head:
        return "empty, holds no scan"
    packed = head.startswith(_GZIP)
    content = unpacked(head)
    if (refusal := _by_content(content)) is not None:
        return refusal
    lower = name.lower()
    if not lower.endswith(JSON_SUFFIXES + CARMEN_SUFFIXES + G2O_SUFFIXES):
        return _by_name(name, content, packed)
    if packed and not lower.endswith(".gz"):
        return f"gzip by its content, but not by its name: rename it to {name}.gz"
    if not packed and lower.endswith(".gz"):
        return f"not gzip, in spite of its name: rename it to {name[:-3]}, or pack it with gzip"
    if content.lstrip().startswith(b"["):
        return f"one JSON array, not JSON lines: write one message a line ({_SEE})"
    return None


def hint(name: str, head: bytes) -> str:
    """What a log without a scan may be instead, to be added to the complaint; "" if that is not known."""
    content, carmen = unpacked(head), name.lower().endswith(CARMEN_SUFFIXES + G2O_SUFFIXES)
    kind, packed = kind_of_text(content), head.startswith(_GZIP)
    if kind == "JSON lines" and carmen:
        return f"; it looks like JSON lines: rename it to {_renamed(name, '.jsonl', packed)}"
    if kind == "CARMEN" and not carmen:
        return f"; it looks like a CARMEN log: rename it to {_renamed(name, '.log', packed)}"
    if kind == "g2o" and not carmen:
        return f"; it looks like a g2o pose graph: rename it to {_renamed(name, '.g2o', packed)}"
    if kind == "JSON":
        return f"; it looks like one JSON document: write one message a line ({_SEE})"
    return "; it is binary, not text" if b"\0" in content else ""


def folder(*, is_bag: bool) -> str:
    """What to say of a folder, as one that holds a ROS 2 bag or not."""
    return _not_read("the folder of a ROS 2 bag", _BAG) if is_bag else "a folder: give a log that is in it"


def unpacked(head: bytes) -> bytes:
    """The begin of what a file holds, unpacked if it is gzip, without a `BOM`, as far as `head` reaches."""
    if not head.startswith(_GZIP):
        return head.removeprefix(BOM)
    try:
        return zlib.decompressobj(wbits=31).decompress(head, HEAD).removeprefix(BOM)
    except zlib.error:
        return b""  # what is corrupt is told when it is read


def kind_of_text(content: bytes) -> Kind | None:
    """What the first line that is neither blank nor a comment looks like."""
    for line in content.splitlines():
        text = line.strip()
        if text and not text.startswith(b"#"):
            return next((kind for pattern, kind in _KINDS if pattern.match(text + b" ")), None)
    return None


def _by_content(content: bytes) -> str | None:
    if content.startswith(b"PK\x03\x04"):
        name = content[30:][: int.from_bytes(content[26:28], "little")]  # of its first member
        if name.endswith(b".npy"):
            return _of_arrays(name)
    for signature, what, advice in _SIGNATURES:
        if content.startswith(signature):
            return _not_read(what, advice)
    start, magic = _TAR
    if content[start : start + len(magic)] == magic:
        return _not_read("a tar archive", _UNPACK)
    if _is_utf16(content):
        return "UTF-16 text: convert it to UTF-8 (iconv -f UTF-16 -t UTF-8)"
    if _GFS_LINE.search(content):
        return _not_read(*_GFS)
    return None


def _of_arrays(first: bytes) -> str:
    """What to say of an .npz file, by the name of its first member."""
    if first == _OUR_ARRAY:
        return "that is a map, not a log: `ogm mapper --start-map` takes it"
    return _not_read("NumPy arrays", _CONVERT)


def _by_name(name: str, content: bytes, packed: bool) -> str:
    if name.lower().removesuffix(".gz").endswith(".gfs"):
        return _not_read(*_GFS)  # its first lines may be CARMEN's
    kind = kind_of_text(content)
    if kind is not None and kind in _TEXTS:
        what, suffix = _TEXTS[kind]
        new = _renamed(name, suffix, packed)
        return f"{what} by its content, but not by its name: rename it to {new}"
    for suffixes, what, advice in _NAMES:
        if name.lower().removesuffix(".gz").endswith(suffixes):
            return _not_read(what, advice)
    return f"not a format that is read; these are {READ}"


def _not_read(what: str, advice: str) -> str:
    return f"{what}, not a format that is read: {advice}"


def _renamed(name: str, suffix: str, packed: bool) -> str:
    stem = name[:-3] if name.lower().endswith(".gz") else name
    return (stem.rpartition(".")[0] or stem) + suffix + (".gz" if packed else "")


def _is_utf16(content: bytes) -> bool:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return True
    # Without a mark at its begin: plain letters, every second byte of them 0.
    even, odd = content[:64:2], content[1:64:2]
    return len(odd) >= 8 and ((not any(odd) and all(even)) or (not any(even) and all(odd)))
