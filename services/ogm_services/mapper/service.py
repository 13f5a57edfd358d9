"""The mapper as a running service: started, warmed up, served, and stopped in order."""

import dataclasses
import importlib.metadata
import logging
import math
import socket
import sys
import threading
import time
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import typer
import zenoh

from ogm_client.session import NetworkConfig, open_session, resolve_listen
from ogm_core.errors import BadInput, OgmError
from ogm_core.wire.keys import MapKeys
from ogm_services.mapper.http_app import http_app
from ogm_services.mapper.intake.zenoh_subscriber import ZenohSubscriber
from ogm_services.mapper.last_map import LastMap
from ogm_services.mapper.live.first_warm_up import warm_up_first
from ogm_services.mapper.live.warm_up import RestOfWarmUp
from ogm_services.mapper.parts import Parts
from ogm_services.mapper.serving.answering_threads import AnsweringThreads
from ogm_services.mapper.serving.http_access import HttpAccess
from ogm_services.mapper.serving.http_server import HttpThread, bound_socket
from ogm_services.mapper.serving.other_mappers import OtherMappers
from ogm_services.mapper.serving.share_part import SharePart
from ogm_services.mapper.serving.update_publisher import UpdatePublisher
from ogm_services.mapper.serving.zenoh_routes import ZenohRoutes
from ogm_services.results.map_folder import check_folder
from ogm_services.runtime.bounded_close import STOP_TIME, Closing, NotStopped, end_as_it_is
from ogm_services.runtime.bounded_start import ended_within
from ogm_services.runtime.service_manager import ServiceManager
from ogm_services.settings.described import differences
from ogm_services.settings.settings import Settings

LIVE_MAP = "live map"
"""What the line with the URL begins with that a mapper prints when it is ready."""
WAKE_PERIOD = 0.5
SWITCH_INTERVAL = 0.0005
"""How long a thread may compute while others wait for Python's lock, s; Python's own 5 ms are ten scans."""
WORKER_TIME = 5.0
"""How long of that the worker may take to finish the scan in hand, s; no scan within the limits does."""

log = logging.getLogger(__name__)


class ServiceStopped(OgmError):
    """A thread without which the mapper is of no use has ended by itself."""

    slug = "service-stopped"


def run_mapper(settings: Settings, out: Path | None) -> None:
    """Run until KeyboardInterrupt; then write the map's files into `out`, if given.

    Raises:
        CannotServe, CannotListen, CannotConnect: an address is taken or unreachable.
        AlreadyMapped: another mapper of this map is alive.
        BadInput: the folder `out` cannot be written, or the map that it starts with is not what is needed.
        ServiceStopped: it ended by itself; the map's files are written all the same.

    A mapper that does not stop within STOP_TIME, while it starts or later, ends the process, with code 1.
    """
    if out is not None:
        if settings.shares.index is not None:
            raise BadInput("--out: a share has but a part of the map: take the whole map from a gateway")
        check_folder(out)
    sys.setswitchinterval(SWITCH_INTERVAL)
    version, changed = importlib.metadata.version("zenoh-ogm"), ", ".join(differences(settings))
    last_map, manager = LastMap(out), ServiceManager()
    with ended_within(STOP_TIME, partial(_end_start, None)):
        service = MapperService(settings, last_map)
    log.info("zenoh-ogm %s starts, with %s", version, changed or "its default settings")
    try:
        with ExitStack() as running:
            with ended_within(STOP_TIME, partial(_end_start, service)):
                service.parts.watch.add(lambda _: manager.alive() if service.working else None)
                running.enter_context(service)
            for line in service.addresses:
                typer.echo(line)
            manager.ready("; ".join(service.addresses))
            try:
                service.wait()
            finally:
                manager.stopping("the map is finished and stored")
    except NotStopped as stuck:
        end_as_it_is(stuck, lambda: _sum_up(service, last_map, "the mapper ends"))
    finally:
        if service.was_ready:
            _sum_up(service, last_map, "the mapper has stopped")


def _sum_up(service: "MapperService", last_map: LastMap, what: str) -> None:
    """Say how it went, and write the figures of the map, which is written."""
    log.info("%s: %s", what, service.totals())
    last_map.write_figures(service.answers, service.time_to_stop)


def _end_start(service: "MapperService | None", held_by: str) -> None:
    """End the process in which a start does not; there is no map yet, unless it stops in order already."""
    if service is not None and service.stopping:
        return
    end_as_it_is(_not_stopped(held_by))


def _not_stopped(held_by: str) -> NotStopped:
    return NotStopped.within(STOP_TIME, "mapper", held_by)


class MapperService:
    """A mapper with its threads, as a context manager: inside the `with` it is ready.

    Threads: the worker (owns the map), those that update cells with it, the monitor (owns the series and the
    truth), the watch, one that looks for other mappers of the map, one that tells followers what has changed,
    one for HTTP's event loop with its pool, Zenoh's own, a small pool for its queries, and one that makes
    rarely used kernels ready. All of them end with the `with`.
    """

    def __init__(self, settings: Settings, last_map: LastMap | None = None) -> None:
        """`last_map` is written when it stops."""
        self._settings = settings
        self._last_map = last_map or LastMap(None)
        self._stop_until = math.inf
        self._access = HttpAccess.of(settings.http)
        self.parts = parts = Parts(settings)
        self.live_map, self.answers, self.memory = parts.live_map, parts.answers, parts.memory
        self._started = time.monotonic()
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
        self.live_map.stop()  # else whoever has asked for figures would keep HTTP and Zenoh from ending
        # The map is on the disk first, whatever else does not end.
        self._stop_until = time.monotonic() + STOP_TIME
        self.parts.stop_mapping(WORKER_TIME)
        closes = Closing(self._open.close)
        try:
            self._last_map.write_map(self.live_map, working=self.working)
        finally:
            held_by = closes.held_after(self.time_to_stop)
            if held_by is not None:
                raise _not_stopped(held_by)

    @property
    def time_to_stop(self) -> float:
        """How long it may still take to stop, s."""
        return max(0.0, self._stop_until - time.monotonic())

    @property
    def stopping(self) -> bool:
        """Whether it has started, and stops."""
        return self.parts.stopping.is_set()

    @property
    def working(self) -> bool:
        """Whether the worker runs, which alone writes the map."""
        return self.parts.worker.alive

    @property
    def was_ready(self) -> bool:
        """Whether it ever got as far as taking scans."""
        return self.parts.ready.is_set()

    def wait(self) -> None:
        """Sleep until KeyboardInterrupt.

        Raises:
            ServiceStopped: the worker or HTTP has ended.
        """
        # Signals may be handed to any thread; Python sees to them when the main thread wakes up.
        while not threading.Event().wait(WAKE_PERIOD):
            for name, alive in (("the worker", self.parts.worker.alive), ("HTTP", self._http_thread.alive)):
                if not alive:
                    raise ServiceStopped(f"{name} has stopped by itself, so the mapper ends: start it again")

    def totals(self) -> str:
        """What became of the scans, and how long that took, in words."""
        scans, seconds = self.parts.receipts.status(since_start=True).scans, time.monotonic() - self._started
        dropped = ", ".join(f"{count} {reason}" for reason, count in scans.dropped.items() if count)
        return (
            f"{scans.received} scans received, {scans.integrated} integrated, {scans.pending} pending, "
            f"dropped: {dropped or 'none'}; it was up for {seconds:.0f} s"
        )

    def _start(self, opening: ExitStack) -> None:
        """Open the network and start the threads; `opening` ends them in the opposite order."""
        opening.callback(self.parts.close)  # for a start that fails; else it is closed before, see below
        network = self._settings.network
        listener = opening.enter_context(bound_socket(self._settings.http.host, self._settings.http.port))
        wanted = network.for_mapper()
        config = dataclasses.replace(wanted, listen=tuple(map(resolve_listen, wanted.listen)))
        session = opening.enter_context(open_session(config))
        keys = MapKeys(network.map_name)
        rest = RestOfWarmUp(self.parts.grid_settings, self._settings.mapper.thread_count)
        opening.callback(rest.stop)  # last: a compiler's pass may take seconds, while all else stops
        share, limits = self.parts.share, self.parts.limits
        others = OtherMappers(session, keys, self.parts.run, share=None if share is None else share.index)
        self.parts.reasons.append(lambda: "; ".join(others.reasons()) or None)
        opening.callback(others.close)  # last of all: until then no other mapper starts
        self._http_threads = opening.enter_context(closing(AnsweringThreads(limits.http_questions)))
        zenoh_threads = opening.enter_context(closing(AnsweringThreads(limits.zenoh_questions)))
        routes = ZenohRoutes(session, keys, self.parts.in_flight)
        opening.callback(routes.close)
        subscriber = ZenohSubscriber(
            *(session, keys, self.parts.queue, self.parts.receipts, self.parts.placer),
            max_beams=limits.beams,
            overload=self.parts.overload,
            in_step=self.parts.in_step,
        )
        self.memory.add("held", lambda: subscriber.hold.held)
        opening.callback(subscriber.close)
        others.claim()
        opening.enter_context(self._http(opening, listener))
        self.updates = UpdatePublisher(self.live_map, self.parts.in_flight)
        opening.callback(self.updates.stop)
        self._declare(routes, zenoh_threads)
        warm_up_first(self.parts.grid_settings, self._settings.mapper.thread_count)
        others.serve()
        self._begin_to_map(opening, session, subscriber, routes)
        self._note_addresses(listener, config)
        self.parts.ready.set()
        opening.callback(self.parts.watch.stop)
        self.parts.watch.start()
        opening.callback(rest.make_way)
        rest.start()

    def _declare(self, routes: ZenohRoutes, threads: AnsweringThreads) -> None:
        """Let it be asked over Zenoh: for the map, or for its part of one."""
        writes, share = self.parts.writes.by_name(), self.parts.share
        if share is None:
            routes.declare(self.answers, writes, threads)
            return
        part = SharePart(share.info(), self.live_map, self.answers, self.parts.in_flight)
        routes.declare_share(share.index, part.answer, self.answers.status, writes["reset"], threads)

    def _begin_to_map(
        self, opening: ExitStack, session: zenoh.Session, subscriber: ZenohSubscriber, routes: ZenohRoutes
    ) -> None:
        """Let the map change: what is to outlive the worker, and see its last change, is open already."""
        opening.callback(self.parts.close)
        self.parts.worker.start()
        opening.callback(self.parts.worker.stop)
        if self.parts.kept_map is not None:
            self.parts.kept_map.keep()
        if self.parts.share is None:
            self.updates.start(session, MapKeys(self._settings.network.map_name).updates)
        subscriber.declare()
        opening.callback(self.parts.monitor.stop)
        self.parts.monitor.start(routes.ask_truth)

    def _note_addresses(self, listener: socket.socket, config: NetworkConfig) -> None:
        """Put down where it is asked, for who started it."""
        zenoh_addresses = ", ".join((*config.listen, *config.connect)) or str(config.config_file)
        share = self.parts.share
        what, part = LIVE_MAP, ""
        if share is not None:
            what, part = "status  ", f", share {share.index} of {share.cuts.count},"
        self.addresses = [
            f"map      {self._settings.network.map_name}{part} on Zenoh at {zenoh_addresses}",
            f"{what} {self._access.url(listener, writes=share is None)}",
        ]

    def _http(self, opening: ExitStack, listener: socket.socket) -> HttpThread:
        app, limits = http_app(self.parts, self._settings, self._access, self._http_threads, opening)
        self._http_thread = HttpThread(app, listener, limits, self.parts.metrics.measurements.http_closed)
        return self._http_thread
