"""Readers of logs, by what the log is: text of any known format, an MCAP recording, or a bag."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from ogm_core.errors import BadRecording
from ogm_core.logs.recorded import ReadDecimals, Recorded
from ogm_core.logs.recordings import RecordingReader
from ogm_core.ros2.bag_files import is_bag
from ogm_core.wire.messages import DEFAULT_MAX_BEAMS
from ogm_services.ros2.mcap_reader import McapReader, holds_recording
from ogm_services.settings.settings import Settings

if TYPE_CHECKING:
    from ogm_services.ros2.bag_reader import BagOptions


class LogReader(AbstractContextManager["LogReader"], Protocol):
    """What a RecordingReader, an McapReader and a BagReader have in common; see there."""

    scans: int
    poses: int
    malformed: int
    complaints: list[str]
    size: int
    unit: str
    """What `malformed` counts, as \"lines\"."""

    @property
    def position(self) -> int:
        """How much of `size` was read."""

    @property
    def not_read(self) -> str:
        """What was passed over; "" if nothing was."""

    @property
    def doubt(self) -> str:
        """What should be known of how the log was read; "" if nothing."""

    def __enter__(self) -> Self: ...

    def __iter__(self) -> Iterator[Recorded]: ...


@dataclass(frozen=True, slots=True)
class ReadAs:
    """How a log is to be read: a longest range, a name for its robot, from which poses; and how, if a bag.

    `bag`: None where nothing was said of bags.
    """

    range_max: float | None = None
    robot: str | None = None
    odometry: bool = False
    bag: "BagOptions | None" = None


AS_IT_SAYS = ReadAs()


def log_reader(
    log: Path,
    read_as: ReadAs,
    settings: Settings,
    *,
    max_beams: int = DEFAULT_MAX_BEAMS,
    decimals: ReadDecimals | None = None,
) -> Callable[[], LogReader]:
    """What opens a log, each time anew.

    Raises:
        BadRecording: what was said of it is for another kind of log.
        MissingExtra: what decompresses an MCAP is not installed.
    """
    recording = holds_recording(log)
    if is_bag(log) and not recording:
        return _bag_reader(log, read_as, settings)
    if read_as.bag is not None:
        raise BadRecording(
            f"{log}: --scan-topic, --cloud-topic, --pose-topic, --mount, --scan-delay and --fixed-frame are "
            "for bags"
        )
    if recording:
        if read_as.odometry:
            raise BadRecording(f"{log}: --odometry is for CARMEN logs; a recording has the poses it has")
        size = log.stat().st_size  # of one that is being recorded each pass reads the same
        return lambda: McapReader(
            log, range_max=read_as.range_max, robot=read_as.robot, max_beams=max_beams, size=size
        )
    return lambda: RecordingReader(
        log,
        range_max=read_as.range_max,
        robot=read_as.robot,
        odometry=read_as.odometry,
        max_beams=max_beams,
        decimals=decimals,
    )


def _bag_reader(log: Path, read_as: ReadAs, settings: Settings) -> Callable[[], LogReader]:
    if read_as.odometry:
        raise BadRecording(f"{log}: --odometry is for CARMEN logs; --fixed-frame odom takes a bag's odometry")
    # Here, because it loads what talks to ROS and to Zenoh, which takes a tenth of a second.
    from ogm_services.ros2.bag_reader import BagOptions, BagReader

    options = read_as.bag or BagOptions()
    return lambda: BagReader(log, options, settings, range_max=read_as.range_max, robot=read_as.robot)
