"""Reader of MCAP recordings: what robots published to a map, as it was, in the order in which it came."""

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

from ogm_core.errors import BadCdr, BadMessage, BadRecording, BadSetting
from ogm_core.logs.jsonl_writer import cannot
from ogm_core.logs.recorded import Recorded, RecordedPose, RecordedScan, no_returns
from ogm_core.logs.recordings import MAX_COMPLAINTS
from ogm_core.logs.renaming import Renaming, check_range_max
from ogm_core.ros2.mcap_reading import McapMessage, McapRecords, is_recording, robot_and_sensor
from ogm_core.ros2.recording_messages import POSE, SCAN, decode_pose, decode_scan
from ogm_core.wire.keys import check_name
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS


def holds_recording(path: Path) -> bool:
    """Whether a file is an MCAP recording; what cannot be read is none.

    Raises:
        MissingExtra: what decompresses it is not installed.
    """
    if not path.is_file():  # what comes out of a pipe could not be read a second time
        return False
    try:
        with path.open("rb") as file:
            return is_recording(file)
    except OSError:
        return False


class McapReader:
    """Reads an MCAP recording once, in file order: the messages of ours, not those beside them for viewers.

    Like a RecordingReader, whose names mean the same here. A recording that was cut short is read as far as
    it goes, and `doubt` says so.

    Raises:
        BadSetting: `range_max` or `robot` cannot be used.
        BadRecording: on entering, the file cannot be opened; while iterating, it is damaged, or holds a
            second robot although `robot` is given; at the end, it held no scan.
    """

    def __init__(
        self,
        path: Path,
        *,
        range_max: float | None = None,
        robot: str | None = None,
        max_beams: int = DEFAULT_MAX_BEAMS,
        size: int | None = None,
    ) -> None:
        """`size`: no more of the file is read, bytes, though it may grow; None: all."""
        check_range_max(range_max)
        self.path, self.unit = path, "messages"
        self.malformed = self.scans = self.poses = self.size = 0
        self.complaints: list[str] = []
        self.topics: Counter[tuple[str, str]] = Counter()
        """Messages by topic and type, those for viewers, too."""
        self.times = (0, 0)
        """When the first and the last of them came, ns."""
        self._at_most = size
        self._range_max = range_max
        self._max_beams = max_beams
        self._renaming = Renaming(path, robot)
        self._records: McapRecords | None = None
        self._opening = ExitStack()

    @property
    def position(self) -> int:
        """Bytes of the file that have been read, of `size`."""
        return 0 if self._records is None else self._records.read

    @property
    def not_read(self) -> str:
        """What was passed over: nothing that is not a message's twin for viewers."""
        return ""

    @property
    def doubt(self) -> str:
        """That its end is missing; "" if it is whole, or was not read to its end."""
        if self._records is None or self._records.whole:
            return ""
        others = ", of the others is read what can be" if self.position < self.size else ""
        return (
            f"it was cut short, or is still being recorded: {self.position} of {self.size} bytes are "
            f"whole{others}, {self.scans} scans and {self.poses} poses; ogm record --repair makes it whole"
        )

    def __enter__(self) -> Self:
        try:
            file = self._opening.enter_context(self.path.open("rb"))
        except OSError as error:
            raise BadRecording(cannot(self.path, "read", error)) from error
        self._records = McapRecords(file, self._at_most)
        self.size = self._records.size
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._opening.close()

    def __iter__(self) -> Iterator[Recorded]:
        if self._records is None:
            raise ValueError("an McapReader is read inside its `with`")
        try:
            for message in self._records:
                first = self.times[0] if self.topics else message.time
                self.times = first, message.time
                self.topics[message.topic, message.type] += 1
                if message.type in (POSE, SCAN) and (recorded := self._recorded(message)) is not None:
                    yield self._renaming.of(recorded)
        except OSError as error:
            raise BadRecording(cannot(self.path, "read", error)) from error
        except BadRecording as error:
            if str(error).startswith(str(self.path)):
                raise
            raise BadRecording(
                f"{self.path}: {error}: ogm record --repair leaves out what is damaged"
            ) from error
        if not self.scans:
            only = f", only {self.poses} poses" if self.poses else ""
            raise BadRecording(f"{self.path}: holds no scan{only}{self._of_malformed()}")

    def _recorded(self, message: McapMessage) -> Recorded | None:
        """A message of ours; None if it is malformed, and counted."""
        robot, sensor = robot_and_sensor(message)
        try:
            check_name(robot, "robot")
            if sensor is not None:
                check_name(sensor, "sensor")
            recorded = self._read(robot, sensor, message.payload)
        except (BadCdr, BadMessage, BadSetting) as error:
            self.malformed += 1
            if len(self.complaints) < MAX_COMPLAINTS:
                self.complaints.append(f"{message.topic}: {error}")
            return None
        if isinstance(recorded, RecordedPose):
            self.poses += 1
        else:
            self.scans += 1
        return recorded

    def _read(self, robot: str, sensor: str | None, payload: bytes) -> Recorded:
        if sensor is None:
            return RecordedPose(robot, decode_pose(payload))
        scan = decode_scan(payload, max_beams=self._max_beams)
        if self._range_max is not None:
            ranges = no_returns(scan.ranges, self._range_max)
            scan = replace(scan, range_max=self._range_max, ranges=ranges)
        return RecordedScan(robot, sensor, scan)

    def _of_malformed(self) -> str:
        if not self.malformed:
            return ""
        return f"; {self.malformed} messages are malformed, first {self.complaints[0]}"
