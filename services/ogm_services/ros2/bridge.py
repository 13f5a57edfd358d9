"""Topics of robots behind a zenoh-bridge-ros2dds, on an open session to it."""

import zenoh

from ogm_core.ros2 import bridge_names
from ogm_core.ros2.topics import Form, Topic
from ogm_services.ros2.topic_source import Take, TakeRequest
from ogm_services.ros2.zenoh_service import ZenohService
from ogm_services.ros2.zenoh_subscription import ZenohSubscription, latched_publisher
from ogm_services.ros2.zenoh_tokens import ZenohTokens


class BridgeSource:
    """Topics of all bridges that a session reaches. They tell no domain: each bridge is in one of its own."""

    form: Form = "bridge"
    domain: int | None = None

    def __init__(self, session: zenoh.Session, where: str) -> None:
        """`session` stays open; `where`: how it is called, in words."""
        self.where = f"zenoh-bridge-ros2dds {where}"
        self._session = session
        self._tokens = ZenohTokens(
            session, bridge_names.TOKENS, bridge_names.read_token, bridge_names.read_service_token
        )

    def topics(self) -> list[Topic]:
        """Publishers and subscribers that are known by now."""
        return self._tokens.topics()

    def subscribe(self, topic: Topic, take: Take) -> ZenohSubscription:
        """Call `take` with each message of a topic, which the bridge reads only from now on."""
        key = bridge_names.data_key(topic.name)
        return ZenohSubscription(self._session, [key], take, history=topic.qos.transient_local)

    def publish_latched(self, name: str, message_type: str) -> "BridgeLatched":
        """Publish on a topic; the bridge asks for its type, and tells it."""
        return BridgeLatched(self._session, bridge_names.data_key(name))

    def serve(self, name: str, service_type: str, take: TakeRequest) -> ZenohService:
        """Offer a service; the bridge keeps to itself what its clients know their requests by."""
        token = bridge_names.service_token(str(self._session.info.zid()), name, service_type)
        self._tokens.ours(token)
        return ZenohService(self._session, bridge_names.data_key(name), token, take)

    def server_of(self, name: str) -> str | None:
        """A node behind a bridge that offers a service of that name by now; bridges tell no names."""
        return None if self._tokens.server_of(name) is None else "a node behind a bridge"

    def close(self) -> None:
        """Withdraw; the session stays open."""
        self._tokens.close()


class BridgeLatched:
    """A topic whose last message is kept for bridges that ask for it."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._publisher = latched_publisher(session, key)

    def put(self, payload: bytes) -> None:
        """Publish a message; it waits rather than drops it."""
        self._publisher.put(payload)

    def look(self) -> None:
        """Nothing: a bridge that comes later asks by itself."""

    def close(self) -> None:
        """Withdraw the topic."""
        self._publisher.undeclare()  # type: ignore[no-untyped-call]
