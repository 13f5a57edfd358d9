"""Parts of a gateway: everything that it is made of once it is on the network, and how they are joined."""

import threading
import time
import uuid
from collections.abc import Callable, Iterator
from functools import partial

import zenoh
from prometheus_client.metrics_core import Metric

from ogm_core.placing.receipts import Receipts
from ogm_core.placing.sensor_rules import SensorRules
from ogm_core.wire.keys import NAME, MapKeys
from ogm_services.mapper.gateway.gateway_writes import GatewayWrites
from ogm_services.mapper.gateway.gathered_answers import GatheredAnswers
from ogm_services.mapper.gateway.share_statuses import ShareStatuses
from ogm_services.mapper.limits import Limits
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.live.newest_scans import NewestScans
from ogm_services.mapper.serving.answer_memory import AnswerMemory
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.live_updates import LiveUpdates
from ogm_services.mapper.serving.load_metrics import memory_metrics, ready_metric
from ogm_services.mapper.serving.metrics import Metrics, gauges
from ogm_services.mapper.shares.gathered_map import GatheredMap
from ogm_services.mapper.shares.gathered_views import followed_map, told_map
from ogm_services.mapper.shares.gathering import Gathering
from ogm_services.mapper.shares.keeping_up import KeepingUp
from ogm_services.mapper.shares.layout import ShareLayout
from ogm_services.mapper.shares.shown_robots import ShownRobots
from ogm_services.replies.in_flight import InFlight
from ogm_services.runtime.memory import MemoryUse
from ogm_services.settings.settings import Settings

LOOK_TIMEOUT = 0.5
"""How long tokens of gateways are waited for, s."""
WATCHED = 2.0
"""So long after somebody has asked for what has changed scans are read that viewers may see, s."""


class GatewayParts:
    """Each attribute says which thread it belongs to. No thread runs yet: the service starts them."""

    def __init__(self, settings: Settings, session: zenoh.Session) -> None:
        """The session stays open as long as they are used."""
        self.ready = threading.Event()
        """Set by the service: it answers."""
        self.stopping = threading.Event()
        """Set by the service: it has begun to stop."""
        self.run = uuid.uuid4().hex
        """Of this process."""
        self.memory = MemoryUse(settings.mapper.max_memory)
        """What all parts hold together; any thread."""
        self.limits = Limits.of(settings.mapper, self.memory)
        self.keys = MapKeys(settings.network.map_name)
        grid_settings = settings.grid_settings()
        layout = ShareLayout.of(settings.shares.cuts, grid_settings.lattice)
        self.gathered = GatheredMap(grid_settings, layout, self.run, self.memory.limit)
        """Who gathers writes it, any thread reads it."""
        timeout = settings.shares.gather_timeout
        self.gathering = Gathering(session, self.keys, self.gathered, timeout)
        """Any thread."""
        self.told, self.followed = told_map(self.gathered), followed_map(self.gathered)
        """The map under its two names; any thread."""
        self.keeping_up = KeepingUp(self.gathering, lambda: self.followed.asked)
        """A thread."""
        self.receipts = Receipts()
        """Where robots are; any thread."""
        self.newest_scans = NewestScans(lambda: self.gathered.state.life[0])
        """A thread notes them, any thread reads."""
        self.robots = ShownRobots(
            *(self.receipts, self.newest_scans, settings.placing_rules()),
            *(SensorRules(settings.sensor_rules()), self.limits.beams),
            watched=lambda: time.monotonic() - self.followed.asked < WATCHED,
        )
        """A thread."""
        self.monitor = Monitor(self.told)
        """A thread: how the map settles, and the true world."""
        self._make_answers(settings, session, timeout)

    def _make_answers(self, settings: Settings, session: zenoh.Session, timeout: float) -> None:
        memory, map_name = self.memory, settings.network.map_name
        self.in_flight = InFlight(self.limits.answer_bytes, memory.left, memory.make_room)
        """Any thread."""
        memory.add("map", lambda: self.gathered.state.copies.nbytes)
        memory.add("answers", lambda: self.in_flight.held, self.in_flight.limit)
        statuses = ShareStatuses(session, self.keys, self.gathered.layout.count, timeout)
        self.answers = GatheredAnswers(
            *(map_name, self.gathered, self.gathering, statuses, self.told, self.followed),
            *(self.receipts, self.monitor, self.ready.is_set, AnswerMemory(memory, self.in_flight)),
            lambda run: _lives(session, self.keys, run),
        )
        """The answering threads ask."""
        self.writes = GatewayWrites(self.answers, self.gathering, statuses)
        """The answering threads ask."""
        self.live_updates = LiveUpdates(
            *(map_name, self.followed, self.answers.map_tiles, self.receipts, self.newest_scans)
        )
        """One thread, the service's, asks; which moment it is, any."""
        self.reasons: list[Callable[[], str | None]] = [
            lambda: None if self.ready.is_set() else "the gateway is still starting",
            lambda: "the gateway is stopping" if self.stopping.is_set() else None,
            self._nobody,
        ]
        """Each tells why the gateway should not be asked now, or None."""
        self.health = Health(
            alive=lambda: self.keeping_up.alive or not self.ready.is_set() or self.stopping.is_set(),
            reasons=self.reasons,
        )
        """Any thread."""
        self.metrics = Metrics(
            partial(memory_metrics, memory), lambda: ready_metric(self.health), self._share_metrics
        )
        """Any thread."""

    def _nobody(self) -> str | None:
        """Why no question would be answered with any of the map."""
        newest = self.gathering.newest
        silent = {each.share for each in newest.missing} - self.gathering.too_large
        if len(silent) < self.gathered.layout.count:
            return None
        refused = "; ".join(f"share {share}: {why}" for share, why in self.gathering.refused.items())
        return f"no share of the map answers{f' ({refused})' if refused else ''}"

    def _share_metrics(self) -> Iterator[Metric]:
        missing = {each.share for each in self.gathering.newest.missing}
        up = {str(share): float(share not in missing) for share in range(self.gathered.layout.count)}
        text = (
            "Whether a share answers, and its part of the map is taken; /status says why not, if it answers."
        )
        yield gauges("ogm_share_up", text, "share", up)


def _lives(session: zenoh.Session, keys: MapKeys, run: str) -> bool:
    """Whether the gateway of a run has a token; waits for the network."""
    if not NAME.fullmatch(run):
        return False
    tokens = session.liveliness().get(keys.alive("gateway", "*", run), timeout=LOOK_TIMEOUT)
    return any(token.ok is not None for token in tokens)
