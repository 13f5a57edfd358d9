"""Writes: what changes a mapper's map, or the maps that it has saved, whichever way it is asked for."""

import logging
import uuid
from collections.abc import Mapping
from typing import Protocol

from ogm_core.errors import BadSetting, DiskFull
from ogm_core.grid_settings import GridSettings
from ogm_core.status import Erasure, Forgotten, encode_status
from ogm_core.wire.keys import Write
from ogm_services.mapper.intake.worker import Worker
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.map_parameters import ERASED_REGION, POLYGON, ROBOT, SNAPSHOT_NAME, area_of
from ogm_services.mapper.serving.query_parameters import check_names
from ogm_services.mapper.storage.failures import StoreFails
from ogm_services.mapper.storage.kept_map import KeptMap
from ogm_services.replies.answer import (
    NO_SNAPSHOTS,
    Answer,
    NotSeparate,
    NotStored,
    Parameters,
    refuse_parameters,
)
from ogm_services.replies.in_flight import InFlight

log = logging.getLogger(__name__)


class DoWrite(Protocol):
    """One of the writes: what is given, and who asks for it."""

    def __call__(self, given: Parameters, who: str) -> Answer:
        """Do it, and answer."""


class Writes:
    """Each is done when it returns. Any thread but the worker, for which they wait, or the store's."""

    def __init__(
        self,
        answers: Answers,
        live_map: LiveMap,
        settings: GridSettings,
        worker: Worker,
        kept_map: KeptMap | None,
        in_flight: InFlight,
    ) -> None:
        """`settings` are the map's; without `kept_map` nothing can be saved."""
        self._answers = answers
        self._live_map = live_map
        self._settings = settings
        self._worker = worker
        self._kept_map = kept_map
        self._in_flight = in_flight

    def by_name(self) -> Mapping[Write, DoWrite]:
        """All of them."""
        return {
            "reset": self.reset,
            "erase": self.erase,
            "forget": self.forget,
            "save": self.save,
            "restore": self.restore,
            "delete": self.delete,
        }

    def reset(self, given: Parameters, who: str) -> Answer:
        """Empty the map, after every message that has arrived; the log says who has asked for it.

        Where the map is stored it is empty on the disk in the end.

        Raises:
            BadParameter: there are parameters.
            Unavailable: the mapper starts, stops or is far behind.
            DiskFull, StoreFails: the map is empty, but that is not stored yet.
        """
        refuse_parameters(given, "reset")
        self._answers.check_ready()
        epoch = uuid.uuid4().hex

        def empty() -> None:
            self._live_map.reset(epoch)
            log.info("%s has reset the map: epoch %s", who, epoch)

        self._worker.do(empty)
        if self._kept_map is not None:
            _store(self._kept_map, "the map is empty")
        return self._answers.status({})

    def erase(self, given: Parameters, who: str) -> Answer:
        """Make the cells of an area unknown, after every message that has arrived; what has been erased.

        Where the map is stored it is on the disk in the end.

        Raises:
            BadParameter: the area is ill-formed, or lies wholly outside the map.
            MapEmpty: the map has no known cell, nor bounds.
            Unavailable: the mapper starts, stops or is far behind.
            DiskFull, StoreFails: the cells are erased, but that is not stored yet.
        """
        check_names(given, (ERASED_REGION, POLYGON))
        self._answers.check_ready()
        area = area_of(given, self._settings.lattice)
        where = self._settings.lattice.region_of(area.rect).span

        def make_unknown() -> Erasure:
            cells = self._live_map.erase(area)
            now = self._live_map.now
            log.info("%s has erased %d cells in %s: revision %d", who, cells, where, now.revision)
            return Erasure(now.epoch, now.run, now.revision, cells)

        erased = self._worker.do(make_unknown)
        if self._kept_map is not None:
            _store(self._kept_map, "the map is erased there")
        return Answer(encode_status(erased), "application/json")

    def forget(self, given: Parameters, who: str) -> Answer:
        """Leave a robot out of the map, after every message that has arrived; the robots that are left.

        Where the map is stored it is on the disk in the end. What is known of the robot's messages stays:
        those that were in the map, or were dropped, do not come again.

        Raises:
            BadParameter: it is no name of a robot.
            NotSeparate: the map does not keep robots apart.
            UnknownRobot: it is not in the map.
            Unavailable: the mapper starts, stops or is far behind.
            DiskFull, StoreFails: the robot is left out, but that is not stored yet.
        """
        check_names(given, (ROBOT,))
        robot = ROBOT.read(given)
        assert robot is not None
        self._answers.check_ready()
        if self._live_map.robots is None:
            raise NotSeparate(
                f"robot {robot}: this map does not keep robots apart: start it with --separate-robots "
                "(mapper.separate_robots) before the first scan"
            )

        def leave_out() -> Forgotten:
            self._live_map.forget(robot)
            now = self._live_map.now
            log.info("%s has left robot %s out of the map: revision %d", who, robot, now.revision)
            return Forgotten(now.epoch, now.run, now.revision, list(self._live_map.robots or ()))

        left = self._worker.do(leave_out)
        if self._kept_map is not None:
            _store(self._kept_map, f"robot {robot} is left out there")
        return Answer(encode_status(left), "application/json")

    def save(self, given: Parameters, who: str) -> Answer:
        """Save the map under a name, after every message that has arrived; what the list says of it.

        Raises:
            Unavailable: the mapper starts, stops or is far behind.
            OgmError: as `KeptMap.save`.
        """
        name, kept = self._asked(given)
        kept.snapshots.check_free(name)
        self._worker.do(lambda: None)
        saved = kept.save(name)
        log.info("%s has saved the map as %s: revision %d", who, name, saved.revision)
        return Answer(encode_status(saved), "application/json")

    def restore(self, given: Parameters, who: str) -> Answer:
        """Go on with the map that is saved under a name, after every message that has arrived; the status.

        It begins a new epoch, at the revision that was saved. What is known of robots stays, and so do the
        scans that wait for poses. It is on the disk in the end.

        Raises:
            UnknownSnapshot, BadParameter, BadStore, BadSetting: there is none, or it cannot be read.
            Busy: there is no memory for it now.
            Unavailable: the mapper starts, stops or is far behind.
            DiskFull, StoreFails: the map is that one now, but is not stored yet.
        """
        name, kept = self._asked(given)
        with kept.snapshots.opened(name) as saved, self._in_flight.making(saved.nbytes):
            grid = saved.grid(self._settings)
            if grid.lattice != self._settings.lattice:
                raise BadSetting(
                    f"name {name}: that map lies on another lattice, anchored at {grid.lattice.anchor}, and "
                    f"this one at {self._settings.lattice.anchor}: a mapper can look at it (at={name}), and "
                    "not go on with it"
                )
            grid.epoch, grid.run = uuid.uuid4().hex, self._live_map.now.run

            def go_on() -> None:
                self._live_map.become(grid)
                log.info(
                    "%s has restored the map %s: epoch %s, revision %d", who, name, grid.epoch, grid.revision
                )

            self._worker.do(go_on)
        _store(kept, f"the map is {name} now")
        return self._answers.status({})

    def delete(self, given: Parameters, who: str) -> Answer:
        """Delete the snapshot of a name; those that are left.

        Raises:
            OgmError: as `Snapshots.delete`.
        """
        name, kept = self._asked(given)
        kept.snapshots.delete(name)
        log.info("%s has deleted the saved map %s", who, name)
        return self._answers.saved.list()

    def _asked(self, given: Parameters) -> tuple[str, KeptMap]:
        """The name that is given, and where its snapshot is or will be."""
        check_names(given, (SNAPSHOT_NAME,))
        name = SNAPSHOT_NAME.read(given)
        assert name is not None
        self._answers.check_ready()
        if self._kept_map is None:
            raise NotStored(NO_SNAPSHOTS)
        return name, self._kept_map


def _store(kept: KeptMap, done: str) -> None:
    """Have the map of this moment on the disk; `done` says what has been done to it in memory.

    Raises:
        DiskFull, StoreFails: it is not stored yet.
    """
    try:
        kept.store_now()
    except (DiskFull, StoreFails) as error:
        raise type(error)(f"{done}, but is not stored yet, which is tried again: {error}") from error
