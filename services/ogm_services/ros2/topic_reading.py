"""Topic reading: a subscription that is declared anew while nothing comes of a topic that somebody publishes.

Through a router that has run for long, late subscribers of rmw_zenoh sometimes get nothing (rmw_zenoh#976).
"""

import logging

from ogm_core.ros2.topics import Topic
from ogm_services.ros2.topic_source import Take, TopicSource

SILENT = 10.0
"""A subscription of which nothing has come for so long is declared anew; then after twice as long, s."""
LONGEST_SILENCE = 600.0

log = logging.getLogger(__name__)


class TopicReading:
    """Reads a topic of a source until it is closed."""

    def __init__(self, source: TopicSource, topic: Topic, take: Take, now: float) -> None:
        """`now` in s."""
        self._source, self._topic, self._take = source, topic, take
        self._heard = False
        self._silence, self._again = SILENT, now + SILENT
        self._subscription = source.subscribe(topic, self._taken)
        log.info("reading %s (%s) of %s", topic.name, topic.type, source.where)

    def look(self, now: float) -> None:
        """Declare the subscription anew if nothing has come for long; for a topic that is still published."""
        if self._heard or now < self._again:
            return
        name, where = self._topic.name, self._source.where
        log.warning(
            "%s of %s: it is published, and nothing has come for %.0f s; subscribing anew",
            name,
            where,
            self._silence,
        )
        self._subscription.close()
        self._subscription = self._source.subscribe(self._topic, self._taken)
        self._silence = min(2.0 * self._silence, LONGEST_SILENCE)
        self._again = now + self._silence

    def close(self) -> None:
        """Read no more."""
        self._subscription.close()

    def _taken(self, payload: bytes) -> None:
        self._heard = True
        self._take(payload)
