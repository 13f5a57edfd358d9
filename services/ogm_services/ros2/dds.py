"""Topics of robots on DDS, the default middleware of every ROS 2: one domain, through Cyclone DDS.

A participant of DDS tells the network of itself by multicast, so there is none unless it is asked for.
"""

import logging
import threading
from typing import Any

from ogm_core.errors import BadCdr, BadSetting, MissingExtra
from ogm_core.ros2 import node_names
from ogm_core.ros2.cdr import TF_MESSAGE
from ogm_core.ros2.topics import MAX_DOMAIN, Form, Qos, Topic, is_topic, ros_type
from ogm_services.ros2.dds_config import dds_config
from ogm_services.ros2.dds_types import raw_type, sample_of
from ogm_services.ros2.topic_source import Take

TOPICS = "rt"
"""What names of topics begin with on DDS."""
_BEST_EFFORT_DEPTH, _RELIABLE_DEPTH = 50, 500
_AT_ONCE = 100
_WAIT_NS = 100_000_000
_MANY = 10_000

log = logging.getLogger(__name__)


class DdsSource:
    """Topics of one domain."""

    form: Form = "dds"

    def __init__(self, domain: int, interface: str | None) -> None:
        """Join a domain on an interface; None: the one that Cyclone chooses.

        Raises:
            BadSetting: there is no such domain, or Cyclone DDS does not take the interface.
            MissingExtra: cyclonedds is not installed.
        """
        if not 0 <= domain <= MAX_DOMAIN:
            raise BadSetting(f"--domain: 0 to {MAX_DOMAIN} are needed, got {domain}")
        self.domain: int | None = domain
        self.where = f"DDS on {interface or 'the interface that Cyclone DDS chooses'}, domain {domain}"
        self._dds = _cyclone()
        try:
            self._own_domain = self._dds.Domain(domain, dds_config(interface))
            self._participant = self._dds.DomainParticipant(domain)
        except self._dds.DDSException as error:
            raise BadSetting(f"{self.where}: cannot be joined: {error}") from error
        self._reading = _Reading(self._dds, self._participant)
        self._ends = [
            (kind == "publication", *self._alive_ends(topic)) for kind, topic in self._dds.builtin.items()
        ]
        self._nodes: dict[bytes, str] = {}
        # Every participant tells of its nodes once, all at once to who comes late.
        all_told = Qos(True, True, _RELIABLE_DEPTH)
        self._reading.add(
            self._reader(node_names.TOPIC, node_names.TYPE, all_told, opaque=True), self._node_told
        )

    def topics(self) -> list[Topic]:
        """Publishers and subscribers that are known by now, ours apart."""
        found: dict[Topic, None] = {}
        for publisher, reader, alive in self._ends:
            for end in reader.read(_MANY, condition=alive):
                if not hasattr(end, "topic_name"):  # of one that has gone
                    continue
                topic = self._topic_of(end, publisher=publisher)
                if topic is not None and end.participant_key != self._participant.guid:
                    found[topic] = None
        return list(found)

    def subscribe(self, topic: Topic, take: Take) -> "_Subscription":
        """Call `take` with each message of a topic; of a transient local one with its last ones first."""
        # Of scans the newest counts; a reader that asks for less than is offered gets it all the same.
        reliable = topic.qos.reliable and (topic.qos.transient_local or topic.type == TF_MESSAGE)
        depth = _RELIABLE_DEPTH if reliable else _BEST_EFFORT_DEPTH
        qos = Qos(reliable, reliable and topic.qos.transient_local, depth)
        reader = self._reader(f"{TOPICS}{topic.name}", topic.type, qos)
        return _Subscription(self._reading, reader, take)

    def publish_latched(self, name: str, message_type: str) -> "DdsLatched":
        """Publish on a topic: reliable, transient local, the last message kept."""
        qos = self._qos(Qos(reliable=True, transient_local=True, depth=1))
        topic = self._dds.Topic(self._participant, f"{TOPICS}{name}", raw_type(message_type), qos=qos)
        return DdsLatched(self._dds.DataWriter(self._participant, topic, qos=qos), message_type)

    def close(self) -> None:
        """Leave the domain."""
        self._reading.close()
        self._ends.clear()
        del self._participant, self._own_domain

    def _reader(self, name: str, message_type: str, asked: Qos, *, opaque: bool = False) -> Any:  # noqa: ANN401
        qos = self._qos(asked)
        topic = self._dds.Topic(self._participant, name, raw_type(message_type, opaque=opaque), qos=qos)
        return self._dds.DataReader(self._participant, topic, qos=qos)

    def _qos(self, asked: Qos) -> Any:  # noqa: ANN401 - cyclonedds' own
        policy = self._dds.Policy
        wait = self._dds.duration(seconds=1)
        reliability = policy.Reliability
        durability = policy.Durability
        return self._dds.Qos(
            reliability.Reliable(wait) if asked.reliable else reliability.BestEffort,
            durability.TransientLocal if asked.transient_local else durability.Volatile,
            policy.History.KeepLast(asked.depth),
        )

    def _alive_ends(self, builtin: Any) -> tuple[Any, Any]:  # noqa: ANN401 - cyclonedds' own
        """The reader of what DDS tells of all publishers, or subscribers, and which of that is still so."""
        reader = self._dds.BuiltinDataReader(self._participant, builtin)
        states = self._dds.InstanceState.Alive | self._dds.ViewState.Any | self._dds.SampleState.Any
        return reader, self._dds.ReadCondition(reader, states)

    def _topic_of(self, end: Any, *, publisher: bool) -> Topic | None:  # noqa: ANN401 - cyclonedds' own
        message_type = ros_type(end.type_name)
        root, _, rest = end.topic_name.partition("/")
        if message_type is None or root != TOPICS or not is_topic(f"/{rest}"):
            return None
        policy = self._dds.Policy
        history = end.qos[policy.History]
        return Topic(
            form="dds",
            name=f"/{rest}",
            type=message_type,
            qos=Qos(
                reliable=isinstance(end.qos[policy.Reliability], policy.Reliability.Reliable),
                transient_local=end.qos[policy.Durability] == policy.Durability.TransientLocal,
                depth=history.depth if isinstance(history, policy.History.KeepLast) else 0,
            ),
            node=self._nodes.get(end.key.bytes, ""),
            domain=self.domain,
            publisher=publisher,
        )

    def _node_told(self, payload: bytes) -> None:
        try:
            self._nodes |= node_names.node_names(payload)
        except BadCdr as error:
            log.debug("%s: %s", self.where, error)


class DdsLatched:
    """A topic that we write, whose last message is kept for readers that come later."""

    def __init__(self, writer: Any, message_type: str) -> None:  # noqa: ANN401 - cyclonedds' own
        self._writer, self._type = writer, message_type

    def put(self, payload: bytes) -> None:
        """Publish a message."""
        self._writer.write(sample_of(self._type, payload))

    def look(self) -> None:
        """Nothing: DDS serves those who come later by itself."""

    def close(self) -> None:
        """Withdraw the topic."""
        self._writer = None


class _Subscription:
    """A reader whose samples are handed on until it is closed."""

    def __init__(self, reading: "_Reading", reader: Any, take: Take) -> None:  # noqa: ANN401 - cyclonedds' own
        self._reading, self._reader = reading, reader
        reading.add(reader, take)

    def close(self) -> None:
        self._reading.remove(self._reader)


class _Reading:
    """A thread that waits for what comes to all readers, and hands it on."""

    def __init__(self, dds: Any, participant: Any) -> None:  # noqa: ANN401 - cyclonedds' own
        self._dds = dds
        self._waiting = dds.WaitSet(participant)
        self._lock = threading.Lock()
        self._readers: list[tuple[Any, Any, Take]] = []
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="dds", daemon=True)
        self._thread.start()

    def add(self, reader: Any, take: Take) -> None:  # noqa: ANN401 - cyclonedds' own
        states = self._dds.ViewState.Any | self._dds.InstanceState.Any | self._dds.SampleState.NotRead
        condition = self._dds.ReadCondition(reader, states)
        with self._lock:
            self._readers.append((reader, condition, take))
            self._waiting.attach(condition)

    def remove(self, reader: Any) -> None:  # noqa: ANN401 - cyclonedds' own
        with self._lock:
            kept = []
            for entry in self._readers:
                if entry[0] is reader:
                    self._waiting.detach(entry[1])
                else:
                    kept.append(entry)
            self._readers = kept

    def close(self) -> None:
        self._ending.set()
        self._thread.join()
        with self._lock:
            self._readers.clear()

    def _run(self) -> None:
        while not self._ending.is_set():
            self._waiting.wait(_WAIT_NS)
            with self._lock:
                for reader, _, take in self._readers:
                    for sample in reader.take(_AT_ONCE):
                        if hasattr(sample, "payload"):
                            take(sample.payload)


def _cyclone() -> Any:  # noqa: ANN401 - what is used of cyclonedds
    """What is used of cyclonedds; read here, since only some have it."""
    try:
        from cyclonedds import builtin, core, domain, pub, sub, topic, util
    except ImportError as error:
        raise MissingExtra("DDS needs cyclonedds: pip install 'zenoh-ogm[ros2,dds]'") from error
    from types import SimpleNamespace

    return SimpleNamespace(
        builtin={
            "publication": builtin.BuiltinTopicDcpsPublication,
            "subscription": builtin.BuiltinTopicDcpsSubscription,
        },
        BuiltinDataReader=builtin.BuiltinDataReader,
        DDSException=core.DDSException,
        DataReader=sub.DataReader,
        DataWriter=pub.DataWriter,
        Domain=domain.Domain,
        DomainParticipant=domain.DomainParticipant,
        InstanceState=core.InstanceState,
        Policy=core.Policy,
        Qos=core.Qos,
        ReadCondition=core.ReadCondition,
        SampleState=core.SampleState,
        Topic=topic.Topic,
        ViewState=core.ViewState,
        WaitSet=core.WaitSet,
        duration=util.duration,
    )
