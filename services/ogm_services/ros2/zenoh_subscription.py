"""Subscriptions to keys on which robots publish over Zenoh, and latched publishers there."""

from collections.abc import Iterable
from contextlib import ExitStack

import zenoh
from zenoh import ext

from ogm_services.ros2.topic_source import Take

NUMBERED = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5)
"""As rmw_zenoh's publishers tell of what they sent last."""


class ZenohSubscription:
    """Hands on the payload of each message on `keys`; what goes with one, old or new, is not looked at."""

    def __init__(self, session: zenoh.Session, keys: Iterable[str], take: Take, *, history: bool) -> None:
        """`history`: publishers are asked for what they keep, also those that come later."""

        def taken(sample: zenoh.Sample) -> None:
            take(sample.payload.to_bytes())

        with ExitStack() as opening:
            for key in keys:
                declared: zenoh.Subscriber[None] | ext.AdvancedSubscriber[None]
                if history:
                    declared = ext.declare_advanced_subscriber(
                        session,
                        key,
                        taken,
                        history=ext.HistoryConfig(detect_late_publishers=True),
                        recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
                        subscriber_detection=True,
                    )
                else:
                    declared = session.declare_subscriber(key, taken)
                opening.callback(declared.undeclare)
            self._open = opening.pop_all()

    def close(self) -> None:
        """Take no more."""
        self._open.close()


def latched_publisher(session: zenoh.Session, key: str) -> ext.AdvancedPublisher:
    """A publisher whose last message is kept for who comes later; it waits rather than drops one."""
    return ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        cache=ext.CacheConfig(max_samples=1),
        sample_miss_detection=NUMBERED,
        publisher_detection=True,
    )
