"""The gateway as a running service: started, served, and stopped in order."""

import dataclasses
import logging
import socket
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing
from importlib.metadata import version
from types import TracebackType
from typing import Self

import typer

from ogm_client.session import open_session, resolve_listen
from ogm_core.errors import OgmError
from ogm_services.mapper.gateway.gateway_parts import GatewayParts
from ogm_services.mapper.http_app import MAP_LIMITS, map_app
from ogm_services.mapper.live.first_warm_up import warm_up_first
from ogm_services.mapper.live.warm_up import RestOfWarmUp
from ogm_services.mapper.serving.answering_threads import AnsweringThreads
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.http_server import HttpThread, bound_socket
from ogm_services.mapper.serving.other_mappers import host_name
from ogm_services.mapper.serving.update_publisher import UpdatePublisher
from ogm_services.mapper.serving.zenoh_routes import ZenohRoutes
from ogm_services.runtime.bounded_close import STOP_TIME, Closing, NotStopped, end_as_it_is
from ogm_services.runtime.bounded_start import ended_within
from ogm_services.runtime.service_manager import ServiceManager
from ogm_services.settings.described import differences
from ogm_services.settings.settings import Settings

WAKE_PERIOD = 0.5
SWITCH_INTERVAL = 0.0005
"""As a mapper's, s: whoever waits for Python's lock is not held up by who decodes a part."""

log = logging.getLogger(__name__)


class GatewayStopped(OgmError):
    """A thread without which the gateway is of no use has ended by itself."""

    slug = "service-stopped"


def run_gateway(settings: Settings) -> None:
    """Run until KeyboardInterrupt.

    Raises:
        BadSetting: the map cannot be cut so.
        CannotServe, CannotListen, CannotConnect: an address is taken or unreachable.
        GatewayStopped: it ended by itself.

    A gateway that does not stop within STOP_TIME, while it starts or later, ends the process, with code 1.
    """
    settings.check_cut()
    sys.setswitchinterval(SWITCH_INTERVAL)
    manager = ServiceManager()
    changed = ", ".join(differences(settings)) or "its default settings"
    log.info("zenoh-ogm %s: a gateway starts, with %s", version("zenoh-ogm"), changed)
    try:
        with ExitStack() as running:
            with ended_within(STOP_TIME, lambda held_by: end_as_it_is(_not_stopped(held_by))):
                service = running.enter_context(GatewayService(settings))
            for line in service.addresses:
                typer.echo(line)
            manager.ready("; ".join(service.addresses))
            try:
                service.wait(manager.alive)
            finally:
                manager.stopping("the gateway stops")
    except NotStopped as stuck:
        end_as_it_is(stuck)


def _not_stopped(held_by: str) -> NotStopped:
    return NotStopped.within(STOP_TIME, "gateway", held_by)


class GatewayService:
    """A gateway with its threads, as a context manager: inside the `with` it answers.

    Threads: one that gathers, one that places robots and their scans for viewers, the monitor (owns the
    series and the truth), one that tells followers what has changed, one for HTTP's event loop with its pool,
    Zenoh's own, a small pool for its queries, and one that makes rarely used kernels ready. All of them end
    with the `with`.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._access = HttpAccess.of(settings.http)
        self._open = ExitStack()
        self.addresses: list[str] = []

    def __enter__(self) -> Self:
        with ExitStack() as opening:
            self._start(opening)
            self._open = opening.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.parts.stopping.set()  # HTTP says so until the rest has stopped, and only then stops itself
        self.parts.told.stop()  # else whoever has asked for figures would keep the others from ending
        held_by = Closing(self._open.close).held_after(STOP_TIME)
        if held_by is not None:
            raise _not_stopped(held_by)
        log.info("the gateway has stopped")

    def wait(self, alive: Callable[[], None] = lambda: None) -> None:
        """Sleep until KeyboardInterrupt; `alive` is told that all is well.

        Raises:
            GatewayStopped: what gathers, or HTTP, has ended.
        """
        # Signals may be handed to any thread; Python sees to them when the main thread wakes up.
        while not threading.Event().wait(WAKE_PERIOD):
            for name, works in (
                ("gathering", self.parts.keeping_up.alive),
                ("HTTP", self._http_thread.alive),
            ):
                if not works:
                    raise GatewayStopped(f"{name} has stopped by itself, so the gateway ends: start it again")
            alive()

    def _start(self, opening: ExitStack) -> None:
        """Open the network and start the threads; `opening` ends them in the opposite order."""
        network = self._settings.network
        listener = opening.enter_context(bound_socket(self._settings.http.host, self._settings.http.port))
        wanted = network.for_client()
        config = dataclasses.replace(wanted, listen=tuple(map(resolve_listen, wanted.listen)), serves=True)
        session = opening.enter_context(open_session(config))
        self.parts = parts = GatewayParts(self._settings, session)
        rest = RestOfWarmUp(self._settings.grid_settings())
        opening.callback(rest.stop)
        http_threads = opening.enter_context(closing(AnsweringThreads(parts.limits.http_questions)))
        zenoh_threads = opening.enter_context(closing(AnsweringThreads(parts.limits.zenoh_questions)))
        routes = ZenohRoutes(session, parts.keys, parts.in_flight)
        opening.callback(routes.close)
        opening.enter_context(self._http(opening, listener, http_threads))
        updates = UpdatePublisher(parts.followed, parts.in_flight)
        opening.callback(updates.stop)
        warm_up_first(self._settings.grid_settings())
        parts.gathering.gather()
        opening.callback(parts.keeping_up.stop)
        parts.keeping_up.start()
        opening.callback(parts.robots.stop)
        parts.robots.start(session, parts.keys)
        routes.declare(parts.answers, parts.writes.by_name(), zenoh_threads)
        updates.start(session, parts.keys.updates)
        opening.callback(parts.monitor.stop)
        parts.monitor.start(routes.ask_truth)
        token = session.liveliness().declare_token(parts.keys.alive("gateway", host_name(), parts.run))
        opening.callback(token.undeclare)
        self._note_addresses(
            listener, ", ".join((*config.listen, *config.connect)) or str(config.config_file)
        )
        parts.ready.set()
        opening.callback(rest.make_way)
        rest.start()

    def _note_addresses(self, listener: socket.socket, zenoh_addresses: str) -> None:
        """Put down where it is asked, for who started it."""
        name, count = self._settings.network.map_name, self.parts.gathered.layout.count
        self.addresses = [
            f"gateway  {name} of {count} shares on Zenoh at {zenoh_addresses}",
            f"live map {self._access.url(listener)}",
        ]

    def _http(self, opening: ExitStack, listener: socket.socket, threads: AnsweringThreads) -> HttpThread:
        app = map_app(self.parts, self._settings.http.max_live, self._access, threads, opening)
        self._http_thread = HttpThread(app, listener, MAP_LIMITS, self.parts.metrics.measurements.http_closed)
        return self._http_thread
