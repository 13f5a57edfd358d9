"""Publisher of a robot: its poses and scans, as Zenoh messages that a mapper integrates."""

import math
import time
import uuid
import warnings
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import zenoh
from numpy.typing import ArrayLike

from ogm_client.channels import Channels
from ogm_client.errors import ClientError, NobodyAnswered, nobody
from ogm_client.heard import not_heard
from ogm_client.map_client import MapClient
from ogm_client.payloads import pose_payload, scan_payload
from ogm_client.session import CONNECT_TIMEOUT, NetworkConfig, is_secured, open_session
from ogm_core.errors import BadSetting
from ogm_core.status import RobotStatus
from ogm_core.types import PoseStamped, Scan
from ogm_core.wire import messages
from ogm_core.wire.keys import MapKeys, check_name
from ogm_core.wire.values import pose_of, scan_of, stamp_of

_POLL = 0.01
_UNITS = {"seconds": 10**9, "milliseconds": 10**6, "microseconds": 10**3}
CACHE_SAMPLES = 600
"""Scans of each sensor that a publisher keeps for a mapper that has missed them, unless told otherwise."""
MAX_CACHE_SAMPLES = 100_000
_DAY_NS = 86_400 * 10**9


class RobotPublisher:
    """Publishes one robot's poses and scans to the mapper of a map.

        with RobotPublisher("robot1") as robot:
            robot.wait_for_mapper(5.0)
            robot.publish_pose(1.0, 2.0, 0.5, stamp=now)
            robot.publish_scan(ranges, angle_min=-1.57, angle_increment=0.01, range_min=0.1, range_max=30)

    Every message is checked by the mapper's own rules before it is sent. Each publisher has a `run` of its
    own, and each key counts its messages from 0 in `seq`, so that the mapper can tell duplicates and losses.

    Messages that the network cannot take in time are dropped, so a slow link never stops a robot; with
    `reliable`, publishing waits instead. A connection that breaks is made again by itself.

    What was dropped, or published while the connection or the mapper was away, the mapper asks for in Zenoh's
    caches, which keep the last `cache_samples` scans of each sensor, and five times as many poses. At 10
    scans and up to 50 poses a second that is the last minute. The defaults take 3 MB for each sensor of 1081
    beams and 1.5 MB for the poses. The publisher has to live until then: what it keeps ends with it. While
    the caches are read over a slow link, publishing waits, a few seconds at most.

    Thread safety: poses and scans may be published from different threads, also those of one key; a lock per
    key makes the order on the wire that of `seq`. Closing while another thread publishes makes that thread's
    call raise ClientError.
    """

    def __init__(
        self,
        robot: str,
        *,
        address: str | None = None,
        zenoh_config: str | Path | None = None,
        session: zenoh.Session | None = None,
        map_name: str = "default",
        run: str | None = None,
        reliable: bool = False,
        cache_samples: int = CACHE_SAMPLES,
        wait: bool = True,
        connect_timeout: float = math.inf,
    ) -> None:
        """Connect to `address`, or use an open `session`, which stays open when the publisher closes.

        Without an address: as `zenoh_config` says, a Zenoh configuration file (JSON5, with TLS if you like),
        else to a mapper on this machine. With both, the address overrides the file's.

        `cache_samples`: how many scans of each sensor are kept; 0: nothing is kept.

        `run` names this run of the robot; None makes a fresh one. A mapper, or a router, that starts later
        is waited for, up to `connect_timeout` in seconds; without `wait` it must be there.

        Raises:
            BadSetting: a name cannot stand in a key, or the address, the file, the timeout or `cache_samples`
                is ill-formed.
            CannotConnect: the address's host is unknown, or nothing takes connections there in time.
            ClientError: the open session is closed.
        """
        _check(connect_timeout, cache_samples)
        if session is not None and zenoh_config is not None:
            raise BadSetting("zenoh_config: an open session has a configuration already; give one of the two")
        self.robot = check_name(robot, "robot")
        self.run = uuid.uuid4().hex if run is None else check_name(run, "run")
        self._keys = MapKeys(map_name)
        self._warned = False
        with ExitStack() as opening:
            if session is None:
                timeout = connect_timeout if wait else CONNECT_TIMEOUT
                network = NetworkConfig.of_client(address, zenoh_config, timeout)
                self._where = network.where
                self._session = open_session(network)
                opening.callback(self._session.close)
            else:
                self._where = "on the open session"
                self._session = session
            self._channels = Channels(
                *(self._session, self._keys, self.robot, self.run, self._where),
                reliable=reliable,
                cache_samples=cache_samples,
            )
            opening.callback(self._channels.close)
            self._open = opening.pop_all()

    def publish_pose(self, x: float, y: float, theta: float, stamp: int | None = None) -> None:
        """Publish the pose of the base in the map frame: metres, and radians counter-clockwise.

        `stamp` in ns since the Unix epoch; None is now.

        Raises:
            BadMessage: a value is of the wrong type, or not finite; nothing is sent.
            ClientError: the publisher or its session is closed.
        """
        pose = pose_of((x, y, theta), "pose")
        channel = self._channels.pose()
        with channel.lock:
            now = time.time_ns() if stamp is None else self._looked_at(stamp_of(stamp))
            channel.put(pose_payload(PoseStamped(now, pose, channel.seq, self.run)), self.run, channel.seq)
            channel.seq += 1

    def publish_scan(
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
    ) -> None:
        """Publish one sweep; beam k looks along `angle_min + k * angle_increment` in the sensor frame.

        Args:
            ranges: metres, shape (N,), sent as float32; inf or `range_max` means "no return", what is above
                `range_max`, NaN, or masked, is no measurement.
            angle_min: bearing of the first beam, rad.
            angle_increment: from beam to beam, rad; negative if clockwise, 0 only of a single beam.
            range_min: nearer readings are no measurements, m.
            range_max: a reading of this much is no return, m; at most 1000.
            sensor: which of the robot's sensors.
            stamp: time of the first beam, ns since the Unix epoch; None is now.
            time_increment: from beam to beam, s.
            mount: pose [x, y, theta] of the sensor in the base frame; None: they coincide.
            pose: pose of the base in the map frame at `stamp`; None: the mapper asks the robot's poses.

        Raises:
            BadMessage: a value is of the wrong type or out of range; nothing is sent.
            BadSetting: `sensor` cannot stand in a key.
            ClientError: the publisher or its session is closed.
        """
        channel = self._channels.scan(sensor)
        with channel.lock:
            scan = scan_of(
                ranges,
                angle_min=angle_min,
                angle_increment=angle_increment,
                range_min=range_min,
                range_max=range_max,
                stamp=time.time_ns() if stamp is None else self._looked_at(stamp_of(stamp)),
                time_increment=time_increment,
                mount=mount,
                pose=pose,
                seq=channel.seq,
                run=self.run,
            )
            channel.put(messages.encode_scan(scan), self.run, channel.seq)
            channel.seq += 1

    def put_pose(self, message: PoseStamped) -> None:
        """Send a pose message as it is, with the `run` and `seq` that it carries; see `put_scan` of run "".

        Raises:
            BadMessage: a mapper would refuse it; nothing is sent.
            ClientError: the publisher or its session is closed.
        """
        payload = pose_payload(message)
        self._channels.declare_run(message.run)
        self._channels.pose().put(payload, message.run, message.seq)

    def put_scan(self, sensor: str, scan: Scan) -> None:
        """Send a scan message as it is, with the `run` and `seq` that it carries.

        Of a message whose run is "" nobody can tell whether it was taken: a mapper that misses it, as it does
        while it starts again, does not ask for it.

        Raises:
            BadMessage: a mapper would refuse it; nothing is sent.
            BadSetting: `sensor` cannot stand in a key.
            ClientError: the publisher or its session is closed.
        """
        payload = scan_payload(scan)
        self._channels.declare_run(scan.run)
        self._channels.scan(sensor).put(payload, scan.run, scan.seq)

    def wait_for_mapper(self, timeout: float = 5.0) -> None:
        """Return once somebody subscribes to this robot's poses.

        What was published before a mapper asks for, as far back as it is kept. `timeout` in seconds. Whether
        access control lets the robot's messages through nobody tells in advance: `feedback` does, once some
        have been published.

        Raises:
            NobodyAnswered: nobody does in time.
        """
        deadline = time.monotonic() + timeout
        channel = self._channels.pose()
        while not channel.matched:
            if time.monotonic() >= deadline:
                raise self._nobody(timeout, timeout)
            time.sleep(_POLL)

    def feedback(self, timeout: float = 5.0) -> RobotStatus:
        """What the mapper says of this robot: of each sensor the scans received, integrated, and dropped why.

            for sensor, source in robot.feedback().sources.items():
                print(sensor, source.integrated, source.dropped, source.hints)

        The counts are those of the robot's name since the mapper started, of earlier runs, too; a robot that
        the mapper has not heard of has no sources. `timeout` of the answer in seconds.

        Raises:
            NotHeard: for some seconds the mapper has heard nothing of what this publisher has published.
            BadSetting: the timeout is not a positive number.
            NobodyAnswered: no mapper of the map does in time.
            MapperError: it is starting, or too busy.
            BadReply: the answer is not a mapper's.
            ClientError: the publisher or its session is closed.
        """
        if self._channels.closed:
            raise ClientError(f"robot {self.robot!r}: the publisher is closed")
        client = MapClient(session=self._session, map_name=self._keys.map_name, timeout=timeout)
        asked = time.monotonic()
        try:
            whole = client.status()
        except NobodyAnswered as error:
            raise self._nobody(timeout, time.monotonic() - asked) from error
        status = whole.robots.get(self.robot, RobotStatus(None, None))
        for source, channel in self._channels.declared():
            if channel.sent.unheard(status, source.sensor, whole.uptime_s, time.monotonic()):
                raise not_heard(source, self._keys.map_name, status)
        return status

    def close(self) -> None:
        """Withdraw from the network; a session that was given stays open. Closing twice does nothing."""
        self._open.close()

    def __enter__(self) -> Self:
        if self._channels.closed:
            raise ClientError(f"robot {self.robot!r}: the publisher is closed; make a new one")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _nobody(self, timeout: float, waited: float) -> NobodyAnswered:
        secured = is_secured(self._session)
        return nobody(self._keys.map_name, self._where, timeout, waited, secured=secured)

    def _looked_at(self, stamp: int) -> int:
        """The stamp itself; warns, once, of one that looks like another unit than ns."""
        if not self._warned:
            now = time.time_ns()
            for unit, ns in _UNITS.items():
                if abs(stamp * ns - now) < _DAY_NS:
                    self._warned = True
                    text = f"stamp: {stamp} looks like {unit} since 1970; ns are needed"
                    warnings.warn(text, stacklevel=3)
        return stamp


def _check(connect_timeout: float, cache_samples: int) -> None:
    if not connect_timeout >= 0.0:
        raise BadSetting(f"connect_timeout: 0 s or more are needed, got {connect_timeout}")
    if type(cache_samples) is not int or not 0 <= cache_samples <= MAX_CACHE_SAMPLES:
        raise BadSetting(f"cache_samples: 0 to {MAX_CACHE_SAMPLES} are needed, got {cache_samples!r}")
