"""What a mapper serves over HTTP: the whole map and its live page, or, as one share of a map, its state."""

from collections.abc import Mapping
from contextlib import ExitStack
from typing import Protocol

from fastapi import FastAPI

from ogm_core.shares import Share
from ogm_core.wire.keys import Write
from ogm_services.mapper.parts import Parts
from ogm_services.mapper.serving.answering_threads import AnsweringThreads
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.http_limits import HttpLimits
from ogm_services.mapper.serving.http_routes import build_app, build_share_app
from ogm_services.mapper.serving.live_clients import LiveClients
from ogm_services.mapper.serving.live_route import LIVE_PATH
from ogm_services.mapper.serving.live_updates import LiveUpdates
from ogm_services.mapper.serving.metrics import Metrics
from ogm_services.mapper.serving.query_routes import BODIES
from ogm_services.mapper.serving.writes import DoWrite
from ogm_services.replies.in_flight import InFlight
from ogm_services.replies.turns import Turns
from ogm_services.settings.settings import Settings

MAP_LIMITS = HttpLimits(bodies=BODIES, websockets=(LIVE_PATH.encode(),))
"""What clients of a whole map may cost."""


class ServesMap(Protocol):
    """The parts of a mapper, or of a gateway, that serve a whole map."""

    @property
    def answers(self) -> Answers:
        """What can be asked."""

    @property
    def live_updates(self) -> LiveUpdates:
        """What live clients are told."""

    @property
    def in_flight(self) -> InFlight:
        """What is being made and sent."""

    @property
    def health(self) -> Health:
        """What probes are told."""

    @property
    def metrics(self) -> Metrics:
        """What Prometheus is told."""

    @property
    def writes(self) -> "ServesWrites":
        """What changes the map."""


class ServesWrites(Protocol):
    """Writes, by name."""

    def by_name(self) -> Mapping[Write, DoWrite]:
        """All of them."""


def http_app(
    parts: Parts, settings: Settings, access: HttpAccess, threads: AnsweringThreads, opening: ExitStack
) -> tuple[FastAPI, HttpLimits]:
    """The application, which `threads` answer, and what clients may cost; `opening` ends what it starts."""
    if parts.share is not None:
        return _share_app(parts, parts.share, settings.network.map_name, access, threads), HttpLimits()
    return map_app(parts, settings.http.max_live, access, threads, opening), MAP_LIMITS


def map_app(
    parts: ServesMap, max_live: int, access: HttpAccess, threads: AnsweringThreads, opening: ExitStack
) -> FastAPI:
    """The application of a whole map; `opening` ends what it starts."""
    measured = parts.metrics.measurements
    # One thread: what live clients want is made once, and takes no more than its part of the machine.
    live_turns = Turns("live", 1, max_live)
    opening.callback(live_turns.close)
    live = LiveClients(
        *(parts.live_updates, live_turns, parts.in_flight, parts.answers.check_started),
        most=max_live,
        origins=access.origins,
        counted=measured.live_clients,
        ended=measured.live_ended,
    )
    return build_app(
        *(parts.answers, parts.health, parts.writes.by_name(), parts.metrics),
        access=access,
        threads=threads,
        in_flight=parts.in_flight,
        live=live,
    )


def _share_app(
    parts: Parts, share: Share, map_name: str, access: HttpAccess, threads: AnsweringThreads
) -> FastAPI:
    return build_share_app(
        *(parts.answers, parts.health, parts.metrics),
        access=access,
        threads=threads,
        in_flight=parts.in_flight,
        what=f"share {share.index} of {share.cuts.count} of map {map_name!r}, which gateways serve",
    )
