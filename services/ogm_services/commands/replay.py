"""`ogm replay`: a recorded log, published as its robots did, and followed until the mapper has handled it."""

import hashlib
import time
import uuid
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Literal

import typer
import zenoh

from ogm_client.errors import ClientError, MapperError, NobodyAnswered
from ogm_client.map_client import MapClient
from ogm_client.robot import RobotPublisher
from ogm_client.session import open_session
from ogm_core.errors import OgmError
from ogm_core.logs.recorded import Recorded, RecordedPose
from ogm_core.status import SourceStatus, Status
from ogm_core.wire.keys import MAX_NAME, Source
from ogm_services.commands.log_readers import AS_IT_SAYS, LogReader, ReadAs, log_reader
from ogm_services.commands.on_the_way import OnTheWay, size_of
from ogm_services.runtime.progress import progress_bar
from ogm_services.settings.settings import Settings

ASK_FROM = 0.5
"""From this part of our share on the mapper is asked how far it is, so that the way never runs dry."""
ASK_EVERY = 16
"""Scans that are sent before it is asked again: its answer is long if there are many robots."""
LONGEST_PAUSE = 10.0
"""Times in a log may be wrong: no pause between two messages is longer than this in the log's time, s."""
MAPPER_PATIENCE = 10.0
"""How long the mapper may take no further scan of ours, or be away, s."""
START_PATIENCE = 60.0
"""How long it may start, compiling its kernels, before anything is sent, s."""
AWAY_POLL = 0.1
_UNAVAILABLE = 503
POSES_PATIENCE = 600.0
"""How long scans that it has taken may wait for poses, s: its `pose_wait` ends that."""
POLL = 0.002

_FRESH = 8
"""Digits of what makes the runs of one replay its own."""
_DIGEST = 16
"""Digits that stand for a run whose name would become too long."""
_FATAL = ("malformed", "overload", "failed", "refused")


class ReplayFailed(OgmError):
    """Scans of the log were lost, or the mapper stopped taking them."""

    slug = "replay-failed"


def run_replay(
    log: Path,
    settings: Settings,
    *,
    speed: float | None,
    read_as: ReadAs = AS_IT_SAYS,
) -> None:
    """Publish a log in file order, at `speed` times its own pace (None: as fast as the mapper takes it).

    Raises:
        BadRecording: the log cannot be read, or holds no scan; nothing is sent.
        CannotConnect, NobodyAnswered: no mapper is there.
        ReplayFailed: a scan was never received, or was dropped as malformed, for overload or by a bug; or the
            mapper was started anew.
    """
    reader, network = log_reader(log, read_as, settings), settings.network
    with reader() as messages:
        total = sum(1 for _ in messages)
    with open_session(network.for_client()) as session, ExitStack() as robots:
        replay = _Replay(session, network.map_name, robots)
        pace = _Pace(speed)
        with reader() as messages, progress_bar("replaying", total, counted=True) as show:
            for done, message in enumerate(messages, 1):
                pace.wait_for(message.message.stamp)
                replay.publish(message)
                show(done)
        typer.echo(f"{log}: {replay.finish()}" + _passed_over(messages))


class _Replay:
    """The state of one replay: publishers by robot, and what of each source is on its way."""

    def __init__(self, session: zenoh.Session, map_name: str, robots: ExitStack) -> None:
        self._session = session
        self._map_name = map_name
        self._opening = robots
        self._client = robots.enter_context(MapClient(session=session, map_name=map_name))
        self._run = uuid.uuid4().hex[:_FRESH]
        self._robots: dict[str, RobotPublisher] = {}
        self._seqs: Counter[Source] = Counter()
        self._sent: Counter[Source] = Counter()
        self._on_the_way = OnTheWay()
        self._unasked = 0
        """Scans that were sent since the mapper was asked."""
        self._was_away = False
        """Whether the mapper was away, as it is where its router or a link ends and comes back."""
        self._before = self._status = self._answered()

    def publish(self, recorded: Recorded) -> None:
        """Send a message under a fresh run; wait first if as many scans as our share are on their way."""
        publisher = self._publisher(recorded.robot)
        if isinstance(recorded, RecordedPose):
            source = Source(recorded.robot, None)
            run, seq = self._renamed(source, recorded.message.run, recorded.message.seq)
            publisher.put_pose(replace(recorded.message, run=run, seq=seq))
            return
        source = Source(recorded.robot, recorded.sensor)
        way, size = self._on_the_way, size_of(recorded.message, self._status.map_info.resolution)
        if self._unasked >= ASK_EVERY and not way.room_for(source, size, ASK_FROM):
            self._follow()
        if not way.room_for(source, size):
            self._patiently(lambda: way.room_for(source, size), "taking scans")
        run, seq = self._renamed(source, recorded.message.run, recorded.message.seq)
        publisher.put_scan(recorded.sensor, replace(recorded.message, run=run, seq=seq))
        way.add(source, run, seq, size)
        self._sent[source] += 1
        self._unasked += 1

    def finish(self) -> str:
        """Wait until the mapper has handled every scan; say what became of them."""

        def received() -> bool:
            return all(self._since(source, "received") >= sent for source, sent in self._sent.items())

        def handled() -> bool:
            return all(_status_of(self._status, source).pending == 0 for source in self._sent)

        self._follow()
        self._patiently(received, "taking scans")
        self._patiently(handled, "handling scans", POSES_PATIENCE)
        dropped = self._dropped()
        if any(dropped.get(reason) for reason in _FATAL):
            raise ReplayFailed(self._report())
        lost = self._status.poses.lost - self._before.poses.lost
        if self._was_away and lost > 0:
            raise ReplayFailed(f"{self._report()}, {lost} poses lost while the mapper was away")
        return self._report()

    def _report(self) -> str:
        total, dropped = self._sent.total(), self._dropped()
        missing = self._missing() - dropped.get("refused", 0)
        parts = [f"{total} scans sent", f"{self._integrated()} integrated"]
        parts += [f"{count} dropped: {reason}" for reason, count in dropped.items()]
        return ", ".join(parts + ([f"{missing} never received"] if missing > 0 else []))

    def _unheard(self) -> str:
        """Why scans were never received, as far as the client knows: Zenoh says nothing to those denied."""
        if self._missing() <= self._dropped().get("refused", 0):
            return ""
        for publisher in self._robots.values():
            try:
                publisher.feedback()
            except ClientError as error:
                return f"; {error}"
        return ""

    def _missing(self) -> int:
        """How many of our scans the mapper does not know of: they were lost on the way, or refused."""
        return self._sent.total() - sum(self._since(source, "received") for source in self._sent)

    def _integrated(self) -> int:
        return sum(self._since(source, "integrated") for source in self._sent)

    def _dropped(self) -> dict[str, int]:
        """Why scans were dropped, if any of ours were: the mapper counts reasons for all robots together."""
        done = sum(self._since(source, "received") - self._since(source, "pending") for source in self._sent)
        before, now = (status.scans.dropped for status in (self._before, self._status))
        ours = now if self._integrated() < done else {"refused"} & now.keys() if self._missing() else {}
        return {reason: now[reason] - before[reason] for reason in ours if now[reason] > before[reason]}

    def _since(self, source: Source, count: Literal["received", "pending", "integrated"]) -> int:
        before, now = _status_of(self._before, source), _status_of(self._status, source)
        return int(getattr(now, count) - getattr(before, count))

    def _follow(self) -> None:
        """Ask the mapper how far it is with every source."""
        before, self._status = self._status, self._answered()
        self._unasked = 0
        for source, total in self._sent.items():
            status = _status_of(self._status, source)
            if status.received < _status_of(before, source).received:
                raise ReplayFailed(
                    "the mapper was started anew meanwhile: reset its map, and replay the log again"
                )
            self._on_the_way.taken(source, status.run, status.last_seq)
            if not status.pending and self._since(source, "received") >= total:
                self._on_the_way.none_waits(source)

    def _answered(self) -> Status:
        """The mapper's status; one that starts is waited for, and, once we have sent, one that is away."""
        begun = bool(self._robots)
        deadline = time.monotonic() + (MAPPER_PATIENCE if begun else START_PATIENCE)
        while True:
            try:
                return self._client.status()
            except (NobodyAnswered, MapperError) as error:
                starts = isinstance(error, MapperError) and error.status == _UNAVAILABLE
                waits = starts or (begun and isinstance(error, NobodyAnswered))
                if time.monotonic() > deadline or not waits:
                    raise
            self._was_away = begun
            time.sleep(AWAY_POLL)

    def _patiently(self, reached: Callable[[], bool], what: str, patience: float | None = None) -> None:
        """Poll until `reached`; give up when what it says of our sources stands still for too long, s."""
        patience = MAPPER_PATIENCE if patience is None else patience
        deadline, seen = time.monotonic() + patience, self._progress()
        while not reached():
            if time.monotonic() > deadline:
                raise ReplayFailed(f"the mapper stopped {what}: {self._report()}{self._unheard()}")
            time.sleep(POLL)
            self._follow()
            if self._progress() != seen:
                deadline, seen = time.monotonic() + patience, self._progress()

    def _progress(self) -> list[SourceStatus]:
        return [_status_of(self._status, source) for source in self._sent]

    def _publisher(self, robot: str) -> RobotPublisher:
        if robot not in self._robots:
            # Nothing is kept: a mapper that asks for what is missing holds a robot back meanwhile, and takes
            # its scans after others that a build takes later.
            publisher = RobotPublisher(
                robot,
                session=self._session,
                map_name=self._map_name,
                run=self._run,
                reliable=True,
                cache_samples=0,
            )
            self._robots[robot] = self._opening.enter_context(publisher)
            publisher.wait_for_mapper(MAPPER_PATIENCE)
        return self._robots[robot]

    def _renamed(self, source: Source, run: str, seq: int) -> tuple[str, int]:
        """Run and seq to send: a recorded run keeps its seqs, messages without a run are renumbered."""
        if run:
            return renamed_run(self._run, run), seq
        self._seqs[source] += 1
        return self._run, self._seqs[source] - 1


def renamed_run(fresh: str, run: str) -> str:
    """A recorded run's name while it is replayed: no other replay's, and no longer than a name may be."""
    name = f"{fresh}.{run}"
    return name if len(name) <= MAX_NAME else f"{fresh}.{hashlib.sha256(run.encode()).hexdigest()[:_DIGEST]}"


class _Pace:
    """Waits between messages as long as their robots did, divided by the speed."""

    def __init__(self, speed: float | None) -> None:
        self._speed = speed
        self._due = time.monotonic()
        self._newest: int | None = None

    def wait_for(self, stamp: int) -> None:
        """Sleep until a message of this stamp, ns, is due."""
        if self._speed is None:
            return
        if self._newest is not None and stamp > self._newest:
            pause = min((stamp - self._newest) / 1e9, LONGEST_PAUSE)
            self._due += pause / self._speed
            time.sleep(max(0.0, self._due - time.monotonic()))
        back = 0 if self._newest is None else self._newest - stamp
        if self._newest is None or back < 0 or back > LONGEST_PAUSE * 1e9:
            self._newest = stamp  # far back: the clock was set, or the stamp before was wrong


def _status_of(status: Status, source: Source) -> SourceStatus:
    """What a mapper's status says of one source; zeros before its first scan."""
    robot = status.robots.get(source.robot)
    known = None if robot is None else robot.sources.get(source.sensor or "")
    return known or SourceStatus(run="", last_seq=None, received=0, pending=0, integrated=0)


def _passed_over(messages: LogReader) -> str:
    text = ""
    if messages.malformed:
        text = (
            f", {messages.malformed} malformed {messages.unit} passed over ({'; '.join(messages.complaints)})"
        )
    if messages.not_read:
        text += f", not read: {messages.not_read}"
    return f"{text}; {messages.doubt}" if messages.doubt else text
