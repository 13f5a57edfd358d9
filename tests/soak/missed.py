"""What a mapper misses while it, or what carries its messages, is away: asked for, and taken once."""

import itertools
import random
import signal
import threading
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from ogm_client import RobotPublisher
from ogm_client.session import NetworkConfig, open_session, resolve_listen
from tests.noting_mapper import MAP_NAME, NotingMapper, Process

SETTLED = 60.0
"""How long a mapper may take until it has taken everything, s."""
SWEEP = {"angle_min": -1.57, "angle_increment": 0.035, "range_min": 0.1, "range_max": 30.0}
BEAMS = 90
CACHED_S = 120.0
"""What robots keep, s: more than a busy machine takes for a few starts in a row that are killed at once."""
_ROBOTS_A_SESSION = 10


class Robots:
    """Robots that publish poses and scans of the same stamps from threads of this process, until `stop`."""

    def __init__(self, endpoint, count, rate, starting=0.0):
        """`count` robots at `rate` Hz that start one by one within `starting` s, and wait for nobody."""
        self.sent = {f"robot{k}": 0 for k in range(count)}
        self._endpoint, self._period, self._starting = endpoint, 1.0 / rate, starting
        self._open = ExitStack()
        self._stopping = threading.Event()
        names = list(self.sent)
        groups = [names[k : k + _ROBOTS_A_SESSION] for k in range(0, count, _ROBOTS_A_SESSION)]
        self._threads = [threading.Thread(target=self._run, args=(group, len(names))) for group in groups]
        for thread in self._threads:
            thread.start()

    def stop(self):
        """Publish no more; what was published is still kept."""
        self._stopping.set()
        for thread in self._threads:
            thread.join()

    def close(self):
        """Go away."""
        self.stop()
        self._open.close()

    def _run(self, names, of):
        network = NetworkConfig(connect=(self._endpoint,), connect_timeout=SETTLED)
        session = self._open.enter_context(open_session(network))
        began, robots = time.monotonic(), {}
        turns = sorted(
            (began + self._starting * int(name[5:]) / of + self._period * random.random(), name)
            for name in names
        )
        while not self._stopping.wait(max(0.0, turns[0][0] - time.monotonic())):
            due, name = turns.pop(0)
            if name not in robots:
                robots[name] = self._open.enter_context(
                    RobotPublisher(
                        name, session=session, map_name=MAP_NAME, cache_samples=round(CACHED_S / self._period)
                    )
                )
            stamp = self.sent[name]
            robots[name].publish_pose(0.0, 0.0, 0.0, stamp=stamp)
            robots[name].publish_scan([1.0] * BEAMS, sensor="laser", stamp=stamp, **SWEEP)
            self.sent[name] += 1
            turns.append((due + self._period, name))
            turns.sort()


@dataclass
class Outcome:
    """What became of poses and scans, counted over all robots."""

    sent: int
    taken: int
    missing: int
    doubled: int
    out_of_order: int
    lost: int
    replayed: int

    @property
    def right(self):
        """Whether each was taken once, in its key's order."""
        return (self.taken, self.missing, self.doubled, self.out_of_order, self.lost) == (
            self.sent,
            0,
            0,
            0,
            0,
        )


def outcome(noted, sent):
    """Compare what was noted with how many poses, and scans, each robot has sent."""
    found = Outcome(
        2 * sum(sent.values()), 0, 0, 0, 0, sum(noted.lost.values()), sum(noted.replayed.values())
    )
    for robot, count in sent.items():
        for key in ("pose", "laser"):
            seqs = noted.seqs(robot, key)
            found.taken += len(seqs)
            found.missing += len(set(range(count)) - set(seqs))
            found.doubled += len(seqs) - len(set(seqs))
            found.out_of_order += sum(later < seq for seq, later in itertools.pairwise(seqs))
    return found


def settled(mapper, robots):
    """Stop the robots, wait until the mapper has all, and compare."""
    robots.stop()
    return all_taken(mapper, robots.sent)


def all_taken(mapper, sent):
    """Wait until the mapper has all, and compare."""
    deadline = time.monotonic() + SETTLED
    while (found := outcome(mapper.noted, sent)).taken < found.sent and time.monotonic() < deadline:
        time.sleep(0.2)
    return found


@contextmanager
def _mapper_and_robots(folder, count, rate, *, starting=0.0, routed=False):
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    with ExitStack() as opening:
        router = opening.enter_context(Process("route", endpoint)) if routed else None
        how = "connect" if routed else "listen"
        mapper = opening.enter_context(NotingMapper(endpoint, folder / "notes", how))
        robots = Robots(endpoint, count, rate, starting)
        opening.callback(robots.close)
        yield mapper, robots, router


def mapper_killed(folder, kills, *, robots, rate, away=1.5):
    """Kill the mapper so many times, at random moments, and start it again after up to `away` s."""
    with _mapper_and_robots(folder, robots, rate, starting=kills * 1.5) as (mapper, publishing, _):
        for _ in range(kills):
            time.sleep(random.uniform(0.3, 3.0))
            mapper.kill()
            time.sleep(random.uniform(0.0, away))
            mapper.start()
        return settled(mapper, publishing)


def mapper_frozen(folder, seconds, *, robots, rate):
    """Freeze the mapper for so long."""
    with _mapper_and_robots(folder, robots, rate) as (mapper, publishing, _):
        time.sleep(1.0)
        mapper.signal(signal.SIGSTOP)
        time.sleep(seconds)
        mapper.signal(signal.SIGCONT)
        time.sleep(1.0)
        return settled(mapper, publishing)


def robot_frozen(folder, seconds):
    """Freeze a robot for so long; its links are closed meanwhile."""
    endpoint = resolve_listen("tcp/127.0.0.1:0")
    with NotingMapper(endpoint, folder / "notes") as mapper, Process("robot", endpoint) as robot:
        for number in (signal.SIGSTOP, signal.SIGCONT, signal.SIGUSR1):
            time.sleep(seconds if number == signal.SIGCONT else 1.5)
            robot.signal(number)
        sent = {"robot0": int(robot.process.stdout.readline())}
        return all_taken(mapper, sent)


def router_killed(folder, kills, *, robots, rate):
    """Kill the router between robots and mapper so many times, and start it again."""
    with _mapper_and_robots(folder, robots, rate, routed=True) as (mapper, publishing, router):
        for _ in range(kills):
            time.sleep(random.uniform(1.0, 3.0))
            router.kill()
            time.sleep(random.uniform(0.0, 1.5))
            router.start()
        time.sleep(1.0)
        return settled(mapper, publishing)


def robots_stopped(folder, *, robots, rate):
    """Robots that publish no more, but are there, while the mapper is away: nothing new ever comes."""
    with _mapper_and_robots(folder, robots, rate) as (mapper, publishing, _):
        time.sleep(1.0)
        mapper.kill()
        time.sleep(1.0)
        publishing.stop()
        mapper.start()
        return settled(mapper, publishing)
