"""Topics of robots whose middleware is rmw_zenoh: one domain, on an open session to their router."""

import itertools
import threading
import time

import zenoh

from ogm_core.ros2 import cdr, rmw_zenoh_names, services
from ogm_core.ros2.rmw_zenoh_names import Entity
from ogm_core.ros2.topics import NO_HASH, TYPE_HASHES, Form, Qos, Topic
from ogm_services.ros2.topic_source import NODE, Take, TakeRequest
from ogm_services.ros2.zenoh_service import ZenohService
from ogm_services.ros2.zenoh_subscription import ZenohSubscription, latched_publisher
from ogm_services.ros2.zenoh_tokens import ZenohTokens

_LATCHED = Qos(reliable=True, transient_local=True, depth=1)


class RmwZenohSource:
    """Topics of one domain, of all distributions: whatever hash of a type their keys carry."""

    form: Form = "rmw_zenoh"

    def __init__(self, session: zenoh.Session, domain: int, where: str) -> None:
        """`session` stays open; `where`: how it is called, in words."""
        self.domain: int | None = domain
        self.where = f"rmw_zenoh {where}, domain {domain}"
        self._session = session
        self._zid = str(session.info.zid())
        self._entities = itertools.count(1)
        self._tokens = ZenohTokens(
            session,
            rmw_zenoh_names.tokens_of(domain),
            rmw_zenoh_names.read_token,
            rmw_zenoh_names.read_service_token,
        )
        self._node: zenoh.LivelinessToken | None = None

    def topics(self) -> list[Topic]:
        """Publishers and subscribers that are known by now, ours apart."""
        return self._tokens.topics()

    def subscribe(self, topic: Topic, take: Take) -> ZenohSubscription:
        """Call `take` with each message of a topic; of a transient local one with its last ones first."""
        keys = [rmw_zenoh_names.data_key(self._domain, topic.name, topic.type)]
        if topic.type == cdr.POINT_CLOUD2:
            keys.append(f"{keys[0]}/{rmw_zenoh_names.BUFFERED}")
        return ZenohSubscription(self._session, keys, take, history=topic.qos.transient_local)

    def publish_latched(self, name: str, message_type: str) -> "RmwZenohLatched":
        """Publish on a topic, for each hash of its type that somebody who subscribes asks for."""
        return RmwZenohLatched(self, name, message_type)

    def serve(self, name: str, service_type: str, take: TakeRequest) -> ZenohService:
        """Offer a service, whichever hash of its type who asks believes in."""
        self._declare_node()
        service = Topic(
            "rmw_zenoh", name, service_type, services.GET_MAP_HASH, services.QOS, NODE, self._domain
        )
        token = rmw_zenoh_names.service_token(service, Entity(self._zid, 0, next(self._entities)))
        self._tokens.ours(token)
        key = rmw_zenoh_names.data_key(self._domain, name, service_type)
        return ZenohService(self._session, key, token, take, _attached)

    def server_of(self, name: str) -> str | None:
        """The node that offers a service of that name by now."""
        told = self._tokens.server_of(name)
        return None if told is None else told.node

    def close(self) -> None:
        """Withdraw; the session stays open."""
        self._tokens.close()
        if self._node is not None:
            self._node.undeclare()  # type: ignore[no-untyped-call]
            self._node = None

    def hashes_asked_for(self, name: str, message_type: str) -> set[str]:
        """Hashes of a type with which somebody subscribes to a topic, "" of Humble."""
        return {
            topic.type_hash
            for topic in self._tokens.topics()
            if not topic.publisher and (topic.name, topic.type) == (name, message_type)
        }

    def declare(self, name: str, message_type: str, type_hash: str) -> "_Publisher":
        """A publisher of one hash, with the tokens that tell ROS 2 of it."""
        self._declare_node()
        topic = Topic("rmw_zenoh", name, message_type, type_hash, _LATCHED, NODE, self._domain)
        token = rmw_zenoh_names.topic_token(topic, Entity(self._zid, 0, next(self._entities)))
        self._tokens.ours(token)
        key = rmw_zenoh_names.data_key(self._domain, name, message_type, type_hash or NO_HASH)
        return _Publisher(self._session, key, token)

    def _declare_node(self) -> None:
        if self._node is None:
            node = rmw_zenoh_names.node_token(self._domain, Entity(self._zid, 0, 0), NODE)
            self._node = self._session.liveliness().declare_token(node)

    @property
    def _domain(self) -> int:
        assert self.domain is not None
        return self.domain


class RmwZenohLatched:
    """A topic that is published for every hash asked for; `put` looks whether there is a new one."""

    def __init__(self, source: RmwZenohSource, name: str, message_type: str) -> None:
        self._source, self._name, self._type = source, name, message_type
        self._publishers: dict[str, _Publisher] = {}
        self._lock = threading.Lock()
        self._last: bytes | None = None
        self._declare_missing()

    def put(self, payload: bytes) -> None:
        """Publish a message; it waits rather than drops it."""
        with self._lock:
            self._last = payload
            self._declare_missing()
            for publisher in self._publishers.values():
                publisher.put(payload)

    def look(self) -> None:
        """Give the last message to those who have come with a hash that nobody asked for before."""
        with self._lock:
            self._declare_missing()

    def close(self) -> None:
        """Withdraw the topic."""
        with self._lock:
            for publisher in self._publishers.values():
                publisher.close()
            self._publishers.clear()

    def _declare_missing(self) -> None:
        asked = {TYPE_HASHES[self._type]} | self._source.hashes_asked_for(self._name, self._type)
        for type_hash in asked - self._publishers.keys():
            publisher = self._source.declare(self._name, self._type, type_hash)
            self._publishers[type_hash] = publisher
            if self._last is not None:
                publisher.put(self._last)


class _Publisher:
    """A publisher under one key, which keeps its last message."""

    def __init__(self, session: zenoh.Session, key: str, token: str) -> None:
        self._publisher = latched_publisher(session, key)
        self._token = session.liveliness().declare_token(token)
        self._gid = rmw_zenoh_names.gid(token)
        self._seqs = itertools.count(1)

    def put(self, payload: bytes) -> None:
        attached = rmw_zenoh_names.attachment(next(self._seqs), time.time_ns(), self._gid)
        self._publisher.put(payload, attachment=attached)

    def close(self) -> None:
        self._token.undeclare()  # type: ignore[no-untyped-call]
        self._publisher.undeclare()  # type: ignore[no-untyped-call]


def _attached(request: bytes) -> bytes:
    return rmw_zenoh_names.reply_attachment(request, time.time_ns())
