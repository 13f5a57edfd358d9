"""What an MCAP recording holds: its topics, those for viewers, too, its times and its frames."""

from contextlib import suppress
from pathlib import Path
from typing import Any

from ogm_core.errors import BadRecording
from ogm_core.logs.recorded import RecordedScan
from ogm_core.ros2.mcap_recording import MAP_FRAME, base_frame, sensor_frame
from ogm_services.ros2.mcap_reader import McapReader

KIND = "recording, MCAP"


def of_recording(file: Path) -> dict[str, Any]:
    """The same as is told of a bag, of as much as can be read.

    Raises:
        BadRecording: it cannot be opened.
    """
    frames: dict[str, dict[str, Any]] = {}
    with McapReader(file) as reader:
        with suppress(BadRecording):  # why nothing is to be mapped is told beside it
            for each in reader:
                base = base_frame(each.robot)
                frames[base] = {"parent": MAP_FRAME, "static": False}
                if isinstance(each, RecordedScan):
                    frames[sensor_frame(each.robot, each.sensor)] = {"parent": base, "static": False}
        topics = [
            {"name": name, "type": kind, "messages": count, "encoding": "cdr"}
            for (name, kind), count in sorted(reader.topics.items())
        ]
        return {
            "file": str(file),
            "kind": KIND,
            "bytes": reader.size,
            "written": {"from_ns": reader.times[0], "to_ns": reader.times[1]},
            "topics": topics,
            "frames": {"": dict(sorted(frames.items()))} if frames else {},
            "notes": [reader.doubt] if reader.doubt else [],
        }
