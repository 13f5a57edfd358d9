"""What a publisher has sent, and whether the mapper has heard of it: access control denies without a word."""

from collections import deque

from ogm_client.errors import NotHeard
from ogm_core.status import RobotStatus, SourceStatus
from ogm_core.wire.keys import Source

UNHEARD = 3.0
"""How long a mapper may take to hear of what was published, s."""
UNHEARD_BEHIND = 10.0
"""The same while scans of the sensor wait in its queue, s."""
_EVERY = 0.5
_KEPT = round(UNHEARD_BEHIND / _EVERY) + 2


class Sent:
    """Samples of the messages that one key's publisher has sent: run, `seq`, time; one each half second."""

    def __init__(self) -> None:
        self._samples: deque[tuple[str, int, float]] = deque(maxlen=_KEPT)

    def note(self, run: str, seq: int, now: float) -> None:
        """Remember a message, unless another one was remembered just before; `now` in s, monotonic."""
        if not self._samples or now - self._samples[-1][2] >= _EVERY:
            self._samples.append((run, seq, now))

    def unheard(self, robot: RobotStatus, sensor: str | None, uptime_s: float, now: float) -> bool:
        """Whether a mapper whose status of the robot this is has missed too long what was sent.

        The key is that of the sensor's scans, or with None that of the poses. Scans are heard if the mapper's
        last one of the sensor is one of those sent, or comes after them; poses, which the status does not
        number, if it has heard of the robot at all. A mapper hears nothing before its start.
        """
        source = None if sensor is None else robot.sources.get(sensor)
        patience = UNHEARD_BEHIND if source is not None and source.pending else UNHEARD
        samples = list(self._samples)
        old = [k for k, (_, _, sent) in enumerate(samples) if now - sent >= patience]
        if not old or uptime_s < patience:
            return False
        if sensor is None:
            return robot.age_s is None and robot.pose is None
        return source is None or not any(_heard(source, run, seq) for run, seq, _ in samples[old[-1] :])


def _heard(source: SourceStatus, run: str, seq: int) -> bool:
    """Whether a source's last scan is this one, or a later one of its run; one that read none has counts."""
    if source.last_seq is None:
        return source.received > 0
    return source.run == run and source.last_seq >= seq


def not_heard(source: Source, map_name: str, status: RobotStatus) -> NotHeard:
    """Say that a mapper hears nothing of a publisher, and what to check."""
    robot, sensor = source
    what = "poses" if sensor is None else f"scans of sensor {sensor!r}"
    theirs = None if sensor is None else status.sources.get(sensor)
    last = "none at all" if theirs is None else f"as its last one seq {theirs.last_seq} of run {theirs.run!r}"
    return NotHeard(
        f"robot {robot!r}: the mapper of map {map_name!r} hears nothing of the {what} that are published "
        f"here (it has {last}): does access control let them through, is the name that of the certificate? "
        "Does another publisher use the name?",
        status,
    )
