"""A map that is cut into shares, without mappers: one grid, of which fake shares tell their own tiles."""

from dataclasses import replace

import msgpack
import numpy as np
import zenoh

from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice, Region
from ogm_core.shares import Cuts
from ogm_core.status import MapInfo, OtherCounts, PoseCounts, ScanCounts, Status, encode_status
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.types import Pose, Scan
from ogm_core.wire.keys import MapKeys
from ogm_core.wire.map_changes import updates_of
from ogm_core.wire.map_update import encode_update
from ogm_services.mapper.shares.layout import ShareLayout
from ogm_services.mapper.shares.share_parts import PartState
from ogm_services.mapper.storage.map_settings import as_text

FOUR = ShareLayout.of(Cuts((0.0,), (0.0,)), Lattice(0.05))
"""Four shares that meet at the anchor."""
SETTINGS = GridSettings(resolution=0.05, reach=5.0)


def scan_at(k, rng):
    """A scan of 60 beams all around, and the pose that it was taken at."""
    scan = Scan(
        stamp=1_000 * (k + 1),
        angle_min=-3.1,
        angle_increment=0.1,
        range_min=0.05,
        range_max=10.0,
        ranges=rng.uniform(0.5, 4.5, 60).astype(np.float32),
    )
    return scan, Pose(*rng.uniform(-6.0, 6.0, 2), 0.3)


class FakeShare:
    """A share: of a grid that has the whole map it tells only what is its own."""

    def __init__(self, index, settings=SETTINGS, layout=FOUR, *, epoch=None, run=None):
        self.index, self.layout = index, layout
        self.grid = OccupancyGrid(settings, epoch or f"e{index}", run or f"r{index}")

    def integrate(self, *scan_and_pose):
        self.grid.integrate(*scan_and_pose)

    @property
    def state(self):
        snapshot = self.grid.snapshot()
        return PartState(
            snapshot.epoch, snapshot.run, snapshot.revision, snapshot.stamp, self.extent(snapshot)
        )

    def extent(self, snapshot):
        """What it serves: the map's own rectangle within its own."""
        far = 2**40
        edges = zip(self.layout.bounds(self.index), (-far, -far, far, far), strict=True)
        x0, y0, x1, y1 = (
            end if edge is None else round(edge / snapshot.lattice.resolution) for edge, end in edges
        )
        return snapshot.rect.intersection(CellRect(x0, y0, x1 - x0, y1 - y0))

    def updates(self, since=None, region=None):
        """The messages of its part, since a revision of this life, None: whole, and in a region."""
        snapshot = self.grid.snapshot()
        copies = snapshot.stored.tiles
        changed = ChangedTiles.since(copies, since or 0)
        if region is not None:
            changed = changed.meeting(snapshot.lattice.cover(region))
        own = self.layout.owners(changed.places) == self.index
        changed = ChangedTiles(copies, changed.tx[own], changed.ty[own])
        return [
            replace(update, extent=self.extent(snapshot))
            for update in updates_of(snapshot, changed, since or 0, whole=since is None)
        ]

    def attachment(self):
        cuts = self.layout.cuts
        told = {"share": self.index, "shares": cuts.count, "cuts_x": list(cuts.x), "cuts_y": list(cuts.y)}
        told["settings"] = as_text(self.grid.settings)
        return self.grid.snapshot().meta() | told


class ServedShare:
    """A fake share on a session, until `close`; while it is `silent` it takes questions, and answers none."""

    def __init__(self, session, share, map_name="m"):
        self.share = share
        self.silent = False
        self.asked = []
        """What it was asked for by those who gather: since when, or of which region."""
        self.scans = {"received": 0, "integrated": 0, "pending": 0, "dropped": {}}
        self.store = self.restored = None
        self._held = []
        self._keys = MapKeys(map_name)
        self._declared = [
            self._declare(session, "part", self._part),
            self._declare(session, "status", self._status),
            self._declare(session, "reset", self._reset),
        ]

    def _declare(self, session, service, answer):
        key = self._keys.share(self.share.index, service)

        def asked(query):
            if self.silent:
                self._held.append(query)  # as long as it is held the question is open
                return
            with query:
                body, attachment = answer(str(query.parameters))
                query.reply(key, body, attachment=attachment)

        return session.declare_queryable(key, zenoh.handlers.Callback(asked, indirect=False), complete=False)

    def _part(self, parameters):
        given = dict(part.split("=") for part in parameters.split(";") if part)
        since, region = given.get("since"), given.get("region")
        self.asked.append(since or region)
        region = region and Region(*map(float, region.split(",")))
        life, _, revision = (since or "").rpartition("-")
        state = self.share.state
        same = life == f"{state.epoch}-{state.run}" and int(revision) <= state.revision
        body = b"".join(map(encode_update, self.share.updates(int(revision) if same else None, region)))
        return body, msgpack.packb(self.share.attachment())

    def _status(self, _):
        state, snapshot = self.share.state, self.share.grid.snapshot()
        poses = PoseCounts(*[0] * 3)
        own = CellRect(*state.extent)
        known = snapshot.part(own).known_cells if own.cells else 0
        status = Status(
            map="m",
            epoch=state.epoch,
            revision=state.revision,
            stamp=state.stamp,
            scans=ScanCounts(**self.scans),
            poses=poses,
            other=OtherCounts(0),
            map_info=MapInfo(known, 1000, own.width, own.height, snapshot.resolution),
            robots={},
            uptime_s=1.0,
            run=state.run,
            restored=self.restored,
            store=self.store,
        )
        return encode_status(status), None

    def _reset(self, parameters):
        self.share.grid.reset(f"{self.share.grid.epoch}+")
        return self._status(parameters)

    def close(self):
        """Be gone."""
        for declared in self._declared:
            declared.undeclare()
        for query in self._held:
            with query:
                pass
