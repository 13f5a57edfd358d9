"""Writer of MCAP recordings that take their name when they are complete."""

from collections.abc import Iterable
from pathlib import Path

from ogm_core.errors import BadRecording, DiskFull
from ogm_core.logs.jsonl_writer import cannot
from ogm_core.logs.recorded import Recorded, RecordedPose
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.whole_files import NO_ROOM, whole_file

MCAP_SUFFIX = ".mcap"


def write_mcap(path: Path, messages: Iterable[Recorded]) -> None:
    """Write an MCAP recording; equal messages give equal files.

    Each message is noted as come at its stamp, or with the one before it if that is later. A failure on the
    way leaves what was there before.

    Raises:
        BadRecording: the file cannot be written.
        DiskFull: there is no room for it.
        MissingExtra: mcap or rosbags is not installed.
    """
    try:
        with whole_file(path) as file:
            writer = McapWriter(file)
            for recorded in messages:
                put(writer, recorded, recorded.message.stamp)
            writer.finish()
    except OSError as error:
        kind = DiskFull if error.errno in NO_ROOM else BadRecording
        raise kind(cannot(path, "written", error)) from error


def put(writer: McapWriter, recorded: Recorded, time: int) -> None:
    """Write a message that came at a time, ns."""
    if isinstance(recorded, RecordedPose):
        writer.pose(recorded.robot, recorded.message, time)
    else:
        writer.scan(recorded.robot, recorded.sensor, recorded.message, time)
