"""`ogm simulate`: robots that drive through a simulated world, live or into a recording."""

import logging
import math
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import typer
import zenoh

from ogm_client.errors import ClientError, NobodyAnswered, NotHeard
from ogm_client.robot import RobotPublisher
from ogm_client.session import open_session
from ogm_core.errors import BadRecording, DiskFull, OgmError
from ogm_core.logs.recordings import JSON_SUFFIXES, Recorded, RecordedPose, RecordedScan, write_jsonl
from ogm_core.placing.rules import DEFAULT_RULES
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.lidar import Lidar, measure
from ogm_core.simulation.worlds import World, dump_world
from ogm_core.types import Pose, PoseStamped, Ranges, Scan, shorter_arc
from ogm_core.wire.keys import MAX_TRUTH_BYTES, MapKeys
from ogm_services.commands.simulator_options import SimulatorOptions
from ogm_services.replies.answer import Answer, Parameters, refuse_parameters
from ogm_services.replies.queryables import Queryables
from ogm_services.replies.turns import Turns
from ogm_services.ros2.mcap_file import MCAP_SUFFIX, write_mcap
from ogm_services.settings.settings import NetworkSettings

SENSOR = "laser"
WAIT_FOR_MAPPER = 5.0
LOOK_TIMEOUT = 2.0
"""How long a look for robots of the same names may take, s."""
HEARD_AFTER = 5.0
"""How often the mapper is asked whether it hears the robots, until it does, s."""
FALLEN_BEHIND = 1.0
"""A simulator that is later than this skips the time that it has lost, s."""

log = logging.getLogger(__name__)


class RobotAlive(OgmError):
    """A robot of the same name is publishing already."""

    slug = "robot-alive"


class Simulation:
    """Robots in a world: what each of them measures at each step. Equal seeds, equal measurements."""

    def __init__(self, options: SimulatorOptions) -> None:
        self.world = world_named(options.world, options.start, tell=log.warning)
        lab = Lidar.lab()
        self.lidar = Lidar(
            beams=lab.beams if options.beams is None else options.beams,
            fov=lab.fov if options.fov is None else options.fov,
            range_max=lab.range_max if options.range_max is None else options.range_max,
            noise=lab.noise if options.noise is None else options.noise,
        )
        self.robots = options.names
        self._radius = options.robot_radius
        seeds = np.random.SeedSequence(options.seed).spawn(options.robots)
        self._noise = [np.random.default_rng(seed) for seed in seeds]

    def step(self, robot: int, step: int) -> tuple[Pose, Ranges]:
        """Pose and ranges of a robot at a step; the robots are spread along the world's path."""
        pose = self._pose(robot, step)
        return pose, measure(self._seen_by(robot, step), pose, self.lidar, self._noise[robot])

    def _pose(self, robot: int, step: int) -> Pose:
        path = self.world.path
        return path.pose(step + robot * path.count // len(self.robots))

    def _seen_by(self, robot: int, step: int) -> World:
        """The world as a robot's LiDAR finds it at a step: with the other robots, if they are seen."""
        others = [other for other in range(len(self.robots)) if other != robot]
        if self._radius is None or not others:
            return self.world
        circles = [(*self._pose(other, step)[:2], self._radius) for other in others]
        return replace(self.world, circles=np.concatenate((self.world.circles, circles)))

    def fastest(self, rate: float) -> float:
        """The highest speed of a robot that is at another pose `rate` times a second, m/s.

        Warns if a mapper, as it is set by default, would not believe that one robot gets so far, or turns so.
        """
        path, period = self.world.path, round(1e9 / rate)
        legs = [(path.pose(step), path.pose(step + 1)) for step in range(path.count)]
        speed = rate * max(math.dist(start[:2], end[:2]) for start, end in legs)
        turning = rate * max(abs(shorter_arc(start.theta, end.theta)) for start, end in legs)
        if not all(DEFAULT_RULES.reachable(period, start, end) for start, end in legs):
            log.warning(
                "at %g scans a second these robots drive up to %.3g m/s and turn up to %.3g rad/s, more than "
                "a mapper believes (mapper.max_speed %g, mapper.max_turn_rate %g unless set): "
                "give a lower --rate",
                *(rate, speed, turning, DEFAULT_RULES.max_speed, DEFAULT_RULES.max_turn_rate),
            )
        return speed

    def messages(self, step: int, stamp: int, run: str) -> Iterator[Recorded]:
        """Every robot's pose and scan of a step; scans take longer, and come after all poses."""
        measured = [self.step(number, step) for number in range(len(self.robots))]
        for robot, (pose, _) in zip(self.robots, measured, strict=True):
            yield RecordedPose(robot, PoseStamped(stamp, pose, step, run))
        for robot, (_, ranges) in zip(self.robots, measured, strict=True):
            yield RecordedScan(robot, SENSOR, self._scan(ranges, step, stamp, run))

    def _scan(self, ranges: Ranges, seq: int, stamp: int, run: str) -> Scan:
        lidar = self.lidar
        return Scan(
            stamp=stamp,
            angle_min=lidar.angle_min,
            angle_increment=lidar.angle_increment,
            range_min=lidar.range_min,
            range_max=lidar.range_max,
            ranges=ranges,
            seq=seq,
            run=run,
        )


def record(options: SimulatorOptions, out: Path) -> None:
    """Write `options.scans` scans of each robot, with their poses, into a recording; stamps begin at 0.

    Raises:
        BadRecording, DiskFull: the file cannot be written.
        MissingExtra: it is an MCAP, and mcap is not installed.
        BadWorld, BadSetting: there is no such world, or no such LiDAR.
    """
    simulation = Simulation(options)
    simulation.fastest(options.rate)
    run = "simulated" if options.seed is None else f"seed-{options.seed}"
    period = 1e9 / options.rate

    def messages() -> Iterator[Recorded]:
        for step in range(options.scans or 0):
            yield from simulation.messages(step, round(step * period), run)

    try:
        _write(out, messages())
    except (BadRecording, DiskFull) as error:
        raise type(error)(f"--out {error}") from error
    typer.echo(f"{out}: {options.scans} scans each of {', '.join(simulation.robots)}")


def _write(out: Path, messages: Iterator[Recorded]) -> None:
    if out.suffix.lower() == MCAP_SUFFIX:
        write_mcap(out, messages)
    elif out.name.lower().endswith(JSON_SUFFIXES):
        write_jsonl(out, messages)
    else:
        raise BadRecording(f"{out}: a name that ends in {', '.join((*JSON_SUFFIXES, MCAP_SUFFIX))} is needed")


def run_simulator(network: NetworkSettings, options: SimulatorOptions) -> None:
    """Publish the robots' poses and scans until KeyboardInterrupt, or until all `options.scans` are sent.

    Meanwhile whoever asks is told the world: the truth that a map can be judged by.

    Raises:
        CannotConnect: no mapper or router is there within `options.connect_timeout`.
        RobotAlive: a robot of one of these names is publishing already.
        BadWorld, BadSetting: there is no such world, or no such LiDAR.
    """
    simulation = Simulation(options)
    truth = _truth(simulation.world)
    run = uuid.uuid4().hex
    with ExitStack() as opening:
        config = replace(network.for_client(), connect_timeout=options.connect_timeout)
        session = opening.enter_context(open_session(config))
        keys = MapKeys(network.map_name)
        robots = {
            robot: opening.enter_context(
                RobotPublisher(robot, session=session, map_name=network.map_name, run=run)
            )
            for robot in simulation.robots
        }
        _refuse_namesakes(session, keys, simulation.robots, run)
        turns, queryables = Turns("truth", threads=1), Queryables(session)
        opening.callback(turns.close)
        opening.callback(queryables.close)
        queryables.declare(keys.truth, truth, turns)
        _wait_for_mapper(robots[simulation.robots[0]])
        opening.enter_context(_told_if_unheard(list(robots.values())))
        named, speed = ", ".join(robots), simulation.fastest(options.rate)
        typer.echo(
            f"{named} in {options.world}: {options.rate:g} scans a second each, at up to {speed:.3g} m/s"
        )
        for step, stamp in _ticks(options):
            for message in simulation.messages(step, stamp, run):
                if isinstance(message, RecordedScan):
                    robots[message.robot].put_scan(message.sensor, message.message)
                else:
                    robots[message.robot].put_pose(message.message)


def _refuse_namesakes(session: zenoh.Session, keys: MapKeys, robots: list[str], run: str) -> None:
    """Look for living robots of these names and of other runs: a mapper takes the poses of one of them only.

    Ours are declared by now, so that of two simulators that start at once one at least sees the other.
    """
    for reply in session.liveliness().get(keys.alive("robot", "*", "*"), timeout=LOOK_TIMEOUT):
        found = None if reply.ok is None else keys.robot_of(str(reply.ok.key_expr))
        if found and found.robot in robots and found.run != run:
            raise RobotAlive(
                f"a robot named {found.robot!r} is publishing to map {keys.map_name!r} already: "
                "choose other names with --robot-prefix"
            )


def _truth(world: World) -> Callable[[Parameters], Answer]:
    """What is answered to queries of the truth: always the same."""
    answer = Answer(dump_world(world).encode(), "application/yaml")
    if len(answer.body) > MAX_TRUTH_BYTES:
        log.warning(
            "mappers will pass over this world as the truth of their maps: its description takes %d bytes, "
            "more than %d",
            len(answer.body),
            MAX_TRUTH_BYTES,
        )

    def truth(given: Parameters) -> Answer:
        refuse_parameters(given, "truth")
        return answer

    return truth


def _wait_for_mapper(robot: RobotPublisher) -> None:
    try:
        robot.wait_for_mapper(WAIT_FOR_MAPPER)
    except NobodyAnswered:
        log.warning("no mapper listens yet: scans are published all the same")


@contextmanager
def _told_if_unheard(robots: list[RobotPublisher]) -> Iterator[None]:
    """Meanwhile warns, once, if the mapper hears nothing of a robot: access control denies without a word."""
    ended = threading.Event()

    def look() -> None:
        while not ended.wait(HEARD_AFTER):
            try:
                for robot in robots:
                    robot.feedback(LOOK_TIMEOUT)
            except NotHeard as error:
                log.warning("%s", error)
            except ClientError:
                continue  # no mapper answers yet
            return

    looking = threading.Thread(target=look, name="heard")
    looking.start()
    try:
        yield
    finally:
        ended.set()
        looking.join()


def _ticks(options: SimulatorOptions) -> Iterator[tuple[int, int]]:
    """Step numbers at the rate of the scans, and when each of them is due, ns since the Unix epoch.

    A step that comes late has its own time all the same: else the next one, in haste, would be a jump.
    """
    due, step = time.monotonic(), 0
    epoch_ns = time.time_ns() - round(due * 1e9)
    while options.scans is None or step < options.scans:
        late = time.monotonic() - due
        if late > FALLEN_BEHIND:
            log.warning("this machine simulates %g scans a second too slowly", options.rate)
            due += late
        time.sleep(max(0.0, -late))
        yield step, epoch_ns + round(due * 1e9)
        due += 1.0 / options.rate
        step += 1
