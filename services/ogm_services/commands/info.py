"""`ogm info`: what a recording, another log or a bag holds, and what is missing in it for a map."""

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import typer

from ogm_core.errors import BadRecording, cut, printable
from ogm_core.logs.recorded import RecordedScan
from ogm_core.ros2.bag_files import ENCODINGS, BagFile, is_bag
from ogm_services.commands.log_readers import AS_IT_SAYS, LogReader, log_reader
from ogm_services.commands.recording_info import of_recording
from ogm_services.ros2.bag_reader import BagReader
from ogm_services.ros2.bag_topics import Edge, edges_in
from ogm_services.ros2.mcap_reader import McapReader, holds_recording
from ogm_services.settings.settings import Settings

_ROWS = 24
"""Topics, and frames of a namespace, that are shown at most; JSON has all."""
_DEEPEST = 12
"""Frames that lie deeper below others are shown at this depth."""


def run_info(file: Path, *, as_json: bool) -> None:
    """Print what a file or a bag's folder holds, in a screen or as JSON.

    Raises:
        BadRecording: it cannot be read at all.
        MissingExtra: it is a bag, and rosbags is not installed.
    """
    recording = holds_recording(file)
    if recording:
        found = of_recording(file)
    else:
        found = _of_bag(file) if is_bag(file) else {"file": str(file), "kind": "log"}
    read = _as_log(file, needed=not (recording or is_bag(file)))
    notes = dict.fromkeys([*found.get("notes", ()), *read["notes"]])
    found |= read | {"notes": list(notes)}
    typer.echo(json.dumps(found, indent=2) if as_json else "\n".join(_lines(found)))


def _of_bag(file: Path) -> dict[str, Any]:
    with BagFile(file) as bag:
        return {
            "file": str(file),
            "kind": bag.kind,
            "bytes": bag.size,
            "written": {"from_ns": bag.start, "to_ns": bag.end},
            "topics": [topic._asdict() for topic in sorted(bag.topics + bag.others)],
            "frames": {
                namespace: {child: edge._asdict() for child, edge in sorted(edges.items())}
                for namespace, edges in edges_in(bag).items()
            },
            "notes": list(bag.notes),
        }


def _as_log(file: Path, *, needed: bool) -> dict[str, Any]:
    """What would go into a map; `needed`: nothing else is known of the file."""
    counts: Counter[str] = Counter()
    stamps: list[int] = []
    missing = None
    reader = log_reader(file, AS_IT_SAYS, Settings())()
    try:
        with reader as messages:
            for each in messages:
                source = each.sensor if isinstance(each, RecordedScan) else "pose"
                counts[f"{each.robot}/{source}"] += 1
                stamps = [min([each.message.stamp, *stamps]), max([each.message.stamp, *stamps])]
    except BadRecording as error:
        if needed and not counts:
            raise
        missing = str(error).removeprefix(f"{file}: ")
    span = {"from_ns": stamps[0], "to_ns": stamps[1]} if stamps else None
    counted = dict(sorted(counts.items()))
    return {"messages": counted, "stamps": span, "notes": _notes(reader), "missing": missing}


def _notes(reader: LogReader) -> list[str]:
    """What a map of the log would suffer from, and what of it would not be read."""
    if isinstance(reader, BagReader):
        notes = reader.doubts
    else:  # of a recording it is told already, and that may have grown since
        notes = [reader.doubt] if reader.doubt and not isinstance(reader, McapReader) else []
    if reader.malformed:
        notes.append(f"{reader.malformed} malformed {reader.unit} ({'; '.join(reader.complaints)})")
    return [*notes, f"not read: {reader.not_read}"] if reader.not_read else notes


def _lines(found: dict[str, Any]) -> list[str]:
    size = f", {found['bytes'] / 1e6:.1f} MB" if "bytes" in found else ""
    lines = [f"{found['file']}: {found['kind']}{size}"]
    for what in ("written", "stamps"):
        span = found.get(what)
        if span is not None:
            seconds = (span["to_ns"] - span["from_ns"]) / 1e9
            lines.append(f"{what}: {seconds:.1f} s, from {_time(span['from_ns'])}")
    topics = [
        f"  {topic['messages']:>8}  {_shown(topic['name'])}  {_shown(_kind(topic))}"
        for topic in found.get("topics", ())
    ]
    lines += _cut(["topics:", *topics]) if topics else []
    trees: list[str] = []
    for namespace, edges in found.get("frames", {}).items():
        if len(trees) < _ROWS:
            tree = _tree({child: Edge(**edge) for child, edge in edges.items()})
            trees += _cut([f"frames of {_shown(namespace) or '/'}:", *tree])
    lines += trees
    if len(found.get("frames", {})) > sum(line.startswith("frames of") for line in trees):
        lines.append("  and those of more namespaces (--json has all)")
    if found["messages"]:
        lines.append("for a map:")
        lines += _cut([f"  {count:>8}  {_shown(source)}" for source, count in found["messages"].items()])
    lines += _cut([f"note: {note}" for note in found["notes"]])
    return [*lines, f"missing for a map: {found['missing'] or 'nothing'}"]


def _shown(name: str) -> str:
    return cut(printable(name))


def _kind(topic: dict[str, Any]) -> str:
    """What a topic's messages are, and how they are written if that is not ROS's way."""
    encoding = topic["encoding"]
    return str(topic["type"]) if encoding in ENCODINGS else f"{topic['type'] or 'no type'}, {encoding}"


def _tree(edges: dict[str, Edge]) -> list[str]:
    """Frames below their parents; those of a loop, which hang below nothing, are left out."""
    below: dict[str, list[str]] = {}
    for child, edge in edges.items():
        below.setdefault(edge.parent, []).append(child)
    lines: list[str] = []
    waiting = [(1, root) for root in sorted(below.keys() - edges.keys(), reverse=True)]
    while waiting:
        depth, frame = waiting.pop()
        moves = "" if frame not in edges or edges[frame].static else "  (moves)"
        lines.append(f"{'  ' * min(depth, _DEEPEST)}{_shown(frame)}{moves}")
        waiting += [(depth + 1, child) for child in sorted(below.get(frame, ()), reverse=True)]
    return lines


def _cut(lines: list[str]) -> list[str]:
    rest = len(lines) - _ROWS
    return lines if rest <= 0 else [*lines[:_ROWS], f"  and {rest} more (--json has all)"]


def _time(stamp: int) -> str:
    return datetime.fromtimestamp(stamp / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
