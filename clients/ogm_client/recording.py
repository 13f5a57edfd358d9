"""Writer of recordings: poses and scans as the JSON lines that `ogm build` and `ogm replay` read."""

import os
import threading
import time
import uuid
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

from numpy.typing import ArrayLike

from ogm_core.errors import BadRecording, DiskFull
from ogm_core.logs.jsonl_writer import jsonl_file
from ogm_core.logs.recorded import Recorded, RecordedPose, RecordedScan
from ogm_core.wire.keys import check_name
from ogm_core.wire.messages import pose_from_fields
from ogm_core.wire.values import pose_of, scan_of, stamp_of


class RecordingWriter:
    """Writes robots' poses and scans into a file, with no mapper and no network.

        with RecordingWriter("drive.jsonl.gz") as recording:
            recording.write_pose(1.0, 2.0, 0.5, stamp=now)
            recording.write_scan(ranges, angle_min=-1.57, angle_increment=0.01, range_min=0.1, range_max=30)

    Arguments mean what they mean to RobotPublisher, and are checked likewise. Each robot's poses, and each
    sensor's scans, are numbered from 0 in the order of writing.

    The file, gzipped if its name ends in .gz, takes its name when the writer closes, however the `with` ends:
    a program that Ctrl-C or an error ends has recorded up to there. Equal messages under one `run` give equal
    files.

    Thread safety: several threads may write.
    """

    def __init__(
        self, path: str | os.PathLike[str], robot: str = "robot1", *, run: str | None = None
    ) -> None:
        """Begin a recording, whose name ends in .jsonl or .jsonl.gz.

        `robot` is whose messages follow, where they do not say another. `run` names this run of the robots;
        None makes a fresh one.

        Raises:
            BadSetting: a name cannot stand in a key.
            BadRecording: the file's name ends otherwise, or it cannot be written.
            DiskFull: there is no room for it.
        """
        self.path = Path(path)
        self.robot = check_name(robot, "robot")
        self.run = uuid.uuid4().hex if run is None else check_name(run, "run")
        self._lock = threading.Lock()
        self._seqs: Counter[tuple[str, str | None]] = Counter()
        self._open = ExitStack()
        self._put = self._open.enter_context(jsonl_file(self.path))
        self._closed = False

    def write_pose(
        self, x: float, y: float, theta: float, stamp: int | None = None, *, robot: str | None = None
    ) -> None:
        """Write the pose of the base in the map frame: metres, and radians counter-clockwise.

        `stamp` in ns since the Unix epoch; None is now. `robot` is another one than the writer's.

        Raises:
            BadMessage: a value is of the wrong type, or not finite; nothing is written.
            BadSetting: `robot` cannot stand in a key.
            BadRecording: the writer is closed, or the file cannot be written.
            DiskFull: there is no room for it; what had its name before is still there.
        """
        name, pose = self._named(robot), pose_of((x, y, theta), "pose")
        with self._lock:
            fields = {
                "stamp": time.time_ns() if stamp is None else stamp_of(stamp),
                "seq": self._seqs[name, None],
                "run": self.run,
                **pose._asdict(),
            }
            self._write(RecordedPose(name, pose_from_fields(fields)))
            self._seqs[name, None] += 1

    def write_scan(
        self,
        ranges: ArrayLike,
        *,
        angle_min: float,
        angle_increment: float,
        range_min: float,
        range_max: float,
        sensor: str = "laser",
        stamp: int | None = None,
        time_increment: float = 0.0,
        mount: ArrayLike | None = None,
        pose: ArrayLike | None = None,
        robot: str | None = None,
    ) -> None:
        """Write one sweep, whose arguments are those of `RobotPublisher.publish_scan`.

        `robot` is another one than the writer's.

        Raises:
            BadMessage: a value is of the wrong type or out of range; nothing is written.
            BadSetting: `sensor` or `robot` cannot stand in a key.
            BadRecording: the writer is closed, or the file cannot be written.
            DiskFull: there is no room for it; what had its name before is still there.
        """
        name, source = self._named(robot), check_name(sensor, "sensor")
        with self._lock:
            scan = scan_of(
                ranges,
                angle_min=angle_min,
                angle_increment=angle_increment,
                range_min=range_min,
                range_max=range_max,
                stamp=time.time_ns() if stamp is None else stamp,
                time_increment=time_increment,
                mount=mount,
                pose=pose,
                seq=self._seqs[name, source],
                run=self.run,
            )
            self._write(RecordedScan(name, source, scan))
            self._seqs[name, source] += 1

    def close(self) -> None:
        """Complete the file, which takes its name now. Closing twice does nothing.

        Raises:
            BadRecording: it cannot be written; a file that had its name before is still there.
            DiskFull: there is no room for it; likewise.
        """
        with self._lock:
            self._closed = True
            self._open.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _named(self, robot: str | None) -> str:
        return self.robot if robot is None else check_name(robot, "robot")

    def _write(self, recorded: Recorded) -> None:
        if self._closed:
            raise BadRecording(f"{self.path}: the recording is closed")
        try:
            self._put(recorded)
        except (BadRecording, DiskFull) as error:
            self._closed = True
            # With the error on its way what was written is no recording, and does not take the name of one.
            self._open.__exit__(type(error), error, error.__traceback__)
            raise
