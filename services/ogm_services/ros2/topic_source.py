"""Topic source: one network, and one domain of it, whose topics are listed, read and written as CDR bytes.

What reads messages, keeps transforms and maps knows none of the sources apart.
"""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from ogm_core.ros2.topics import Form, Topic

Take = Callable[[bytes], None]
"""What is called with each message's CDR, from any thread; it only hands it on."""
NODE = "/ogm"
"""The name under which we are a node of ROS 2."""


class Closing(Protocol):
    """What goes on until it is closed."""

    def close(self) -> None:
        """End it; closing twice does nothing."""


class Latched(Closing, Protocol):
    """A topic that we publish, whose last message everyone gets who comes later."""

    def put(self, payload: bytes) -> None:
        """Publish a message's CDR; it waits rather than drops it."""

    def look(self) -> None:
        """Serve those who have come since in a way that has to be looked after; called now and then."""


class TopicSource(Closing, Protocol):
    """Topics of one network and domain."""

    @property
    def form(self) -> Form:
        """How its messages come."""

    @property
    def domain(self) -> int | None:
        """Its ROS_DOMAIN_ID; None where topics tell none."""

    @property
    def where(self) -> str:
        """The network in words, with the domain."""

    def topics(self) -> list[Topic]:
        """Publishers and subscribers that are known by now, ours apart."""

    def subscribe(self, topic: Topic, take: Take) -> Closing:
        """Call `take` with each message of a topic; of a transient local one with its last ones first."""

    def publish_latched(self, name: str, message_type: str) -> Latched:
        """Publish on a topic: reliable, transient local, the last message kept."""


class Request(Protocol):
    """What somebody asks of a service that we offer; one of the two is called, once, from any thread."""

    def answer(self, payload: bytes) -> None:
        """Reply with a message's CDR."""

    def refuse(self, why: str) -> None:
        """Say why there is no reply."""


TakeRequest = Callable[[Request], None]
"""What is called with each request, from any thread; it only hands it on."""


@runtime_checkable
class ServiceSource(TopicSource, Protocol):
    """A source on which services can be offered, too: over Zenoh.

    On DDS they cannot. Replies to Fast DDS, the default of ROS 2, are known by what Cyclone DDS cannot write
    beside a message; those to rmw_cyclonedds have 16 bytes before the fields, which its types, as it tells
    them from 2025 on, do not have: cyclonedds writes no such sample, or is not heard.
    """

    def serve(self, name: str, service_type: str, take: TakeRequest) -> Closing:
        """Offer a service, whose requests have no field that is read."""

    def server_of(self, name: str) -> str | None:
        """Who offers a service of that name by now, in words; None: nobody."""
