"""`ogm ros2`: robots that run ROS 2, as they are, put on a mapper's map; and a list of their topics."""

import json
import logging
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

import typer
import zenoh

from ogm_client.errors import CannotConnect
from ogm_client.robot import RobotPublisher
from ogm_client.session import CONNECT_TIMEOUT, NetworkConfig, open_session
from ogm_core.errors import BadInput, BadSetting
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.ros2.topics import MAX_DOMAIN, Topic, check_topic
from ogm_core.ros2.typestore import check_installed
from ogm_core.wire.addresses import masked
from ogm_services.ros2.account import Account
from ogm_services.ros2.bridge import BridgeSource
from ogm_services.ros2.dds import DdsSource
from ogm_services.ros2.dds_config import chosen_interface
from ogm_services.ros2.gateway import Gateway, NamedSource
from ogm_services.ros2.map_fetch import MapFetch
from ogm_services.ros2.map_publisher import MapPublisher, updates_topic
from ogm_services.ros2.mapper_watch import MapperWatch
from ogm_services.ros2.options import Ros2Options
from ogm_services.ros2.rmw_zenoh import RmwZenohSource
from ogm_services.ros2.robots import Robots
from ogm_services.runtime.limited_log import LimitedLog
from ogm_services.settings.entries import check_for_whom
from ogm_services.settings.settings import Settings

LISTEN = 3.0
"""How long `--list` listens for topics, s: on DDS those of others are told one after the other."""
OURS = frozenset({"mount", "deskew"})
"""The keys of --sensor that are decided here; the mapper decides the others."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Networks:
    """Where robots are looked for: on DDS, at Zenoh endpoints (of routers and bridges), in which domains.

    `interface`: of DDS; None: that of the default route.
    """

    dds: bool = False
    zenoh: tuple[str, ...] = ()
    domains: tuple[int, ...] = (0,)
    interface: str | None = None

    def __post_init__(self) -> None:
        if not (self.dds or self.zenoh):
            raise BadInput(
                "where are the robots? --dds for the default of ROS 2, --zenoh tcp/ROBOT:7447 for the router "
                "of rmw_zenoh or a zenoh-bridge-ros2dds"
            )
        if self.interface is not None and not self.dds:
            raise BadInput("--interface: it is DDS's, so --dds is needed, too")
        for domain in self.domains:
            if not 0 <= domain <= MAX_DOMAIN:
                raise BadSetting(f"--domain: 0 to {MAX_DOMAIN} are needed, got {domain}")


@contextmanager
def open_sources(networks: Networks, timeout: float = math.inf) -> Iterator[list[NamedSource]]:
    """Join the networks; what is joined is said. Each endpoint is waited for, for `timeout`, s.

    Raises:
        BadSetting, MissingExtra: one cannot be joined.
        CannotConnect: a host is unknown, or nothing takes connections there in time.
    """
    with ExitStack() as opening:
        found: list[NamedSource] = []
        interface = chosen_interface(networks.interface) if networks.dds else None
        for domain in networks.domains if networks.dds else ():
            found.append(NamedSource(DdsSource(domain, interface), f"domain{domain}"))
            opening.callback(found[-1].source.close)
        for endpoint in networks.zenoh:
            session = opening.enter_context(_session_with_robots(endpoint, timeout))
            where = f"at {masked(endpoint)}"
            host = f"{_host(endpoint)}." if len(networks.zenoh) > 1 else ""
            for domain in networks.domains:
                found.append(NamedSource(RmwZenohSource(session, domain, where), f"{host}domain{domain}"))
                opening.callback(found[-1].source.close)
            found.append(NamedSource(BridgeSource(session, where), f"{host}bridge"))
            opening.callback(found[-1].source.close)
        for source, _ in found:
            log.info("looking for robots: %s", source.where)
        yield found


def list_topics(networks: Networks, *, as_json: bool) -> None:
    """Print the topics that are published, after listening for a moment."""
    with open_sources(networks, CONNECT_TIMEOUT) as sources:
        time.sleep(LISTEN)
        topics = [
            (source.where, topic)
            for source, _ in sources
            for topic in sorted(source.topics(), key=lambda topic: (topic.name, topic.node))
            if topic.publisher
        ]
    if as_json:
        typer.echo(json.dumps([_json(where, topic) for where, topic in topics], indent=2))
        return
    from ogm_services.commands.ros2_table import print_topics

    print_topics(topics, [source.where for source, _ in sources])


@dataclass(frozen=True, slots=True)
class Published:
    """The topics that the map is published on: of free, occupied and unknown cells, and of probabilities."""

    trinary: str | None = None
    probabilities: str | None = None

    def __post_init__(self) -> None:
        for flag, name in {
            "--publish-map": self.trinary,
            "--publish-probabilities": self.probabilities,
        }.items():
            if name is not None:
                check_topic(name, flag)
        names = [name for name in (self.trinary, self.probabilities) if name is not None]
        topics = [*names, *map(updates_topic, names)]
        if len(set(topics)) < len(topics):
            raise BadSetting(
                "--publish-map, --publish-probabilities: two topics are needed, and neither the other's "
                f"with changes; these would be {', '.join(topics)}"
            )


def run_ros2(
    networks: Networks, options: Ros2Options, settings: Settings, published: Published = Published()
) -> None:
    """Send robots' poses and scans to a mapper, and its map to them if asked to, until KeyboardInterrupt.

    Raises:
        BadSetting, MissingExtra, CannotConnect: a network cannot be joined.
        TopicTaken: the map cannot be published there.
    """
    check_installed()
    network, account = settings.network, Account(LimitedLog(log))
    with ExitStack() as opening:
        sources = opening.enter_context(open_sources(networks))
        config = replace(network.for_client(), connect_timeout=math.inf)
        session = opening.enter_context(open_session(config))

        def publisher(robot: str) -> RobotPublisher:
            return RobotPublisher(robot, session=session, map_name=network.map_name)

        robots = Robots(publisher, settings.robots, options.map_frame, account)
        opening.callback(robots.close)
        rules = SensorRules(settings.sensor_rules())
        gateway = Gateway(sources, robots, account, options, rules, settings.mapper.pose_gap)
        opening.callback(gateway.close)
        opening.callback(_tell, account)
        watch = MapperWatch(robots, network.map_name, config.where)
        if published == Published():
            gateway.run(watch.look)
        publisher_of_map = MapPublisher(
            [source for source, _ in sources],
            MapFetch(session, network.map_name, options.map_frame),
            trinary=published.trinary,
            probabilities=published.probabilities,
        )
        opening.callback(publisher_of_map.close)

        def look() -> None:
            watch.look()
            publisher_of_map.check()

        gateway.run(look)


def check_sensors(texts: list[str] | None) -> None:
    """Refuse what --sensor says that is the mapper's to decide.

    Raises:
        BadSetting: there is such a key.
    """
    mapper = "the mapper: ogm mapper --sensor {!r}; here mount and deskew can be given"
    check_for_whom("sensors", texts or (), "--sensor", OURS, mapper)


def check_robots(texts: list[str] | None) -> None:
    """The same of --robot."""
    mapper = "the mapper: ogm mapper --robot {!r}; here origin and name can be given"
    check_for_whom("robots", texts or (), "--robot", {"origin", "name"}, mapper)


def _tell(account: Account) -> None:
    for line in account.lines():
        log.info("%s", line)


def _session_with_robots(endpoint: str, timeout: float) -> zenoh.Session:
    try:
        return open_session(NetworkConfig(connect=(endpoint,), connect_timeout=timeout))
    except CannotConnect as error:
        if error.__cause__ is None:  # it says already what is wrong with the address
            raise
        raise CannotConnect(
            f"cannot connect to {masked(endpoint)}: does the router of rmw_zenoh, or a zenoh-bridge-ros2dds, "
            "run on the robot, and take connections from other machines on this port?"
        ) from error


def _host(endpoint: str) -> str:
    return endpoint.partition("/")[2].rpartition(":")[0].strip("[]")


def _json(where: str, topic: Topic) -> dict[str, object]:
    return {
        "source": topic.form,
        "where": where,
        "domain": topic.domain,
        "topic": topic.name,
        "type": topic.type,
        "type_hash": topic.type_hash or None,
        "qos": {
            "reliable": topic.qos.reliable,
            "transient_local": topic.qos.transient_local,
            "depth": topic.qos.depth,
        },
        "node": topic.node or None,
    }
