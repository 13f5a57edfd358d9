"""Queries of a mapper: what it computes from its map for who asks, without sending the map."""

import json
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ogm_client.errors import BadReply
from ogm_client.footprints import footprints_of
from ogm_client.map_layer import MapLayer
from ogm_client.parameters import texts
from ogm_client.raycast import WORDS, Rays, Unknown
from ogm_client.status_reply import read_reply
from ogm_client.transport import Transport, printable
from ogm_core.errors import BadInput
from ogm_core.files.layer_files import DISTANCE, OCCUPANCY, read_layer_npz
from ogm_core.queries.footprints import WORDS as STATES
from ogm_core.queries.rays import FOUND_NOTHING, FOUND_UNKNOWN, FOUND_WALL
from ogm_core.queries.replies import CheckReply, RaycastReply
from ogm_core.wire.messages import MAX_RANGE

_ENDS = {"hit": WORDS[FOUND_WALL], "unknown": WORDS[FOUND_UNKNOWN], "none": WORDS[FOUND_NOTHING]}


class MapQueries:
    """What a `MapClient` asks its mapper to compute, over the connection that it has."""

    _transport: Transport
    _max_bytes: int

    def raycast(
        self,
        x: float,
        y: float,
        theta: float = 0.0,
        *,
        angle_min: float = 0.0,
        angle_increment: float = 0.0,
        n: int = 1,
        max_range: float = MAX_RANGE,
        unknown: Unknown = "stop",
    ) -> Rays:
        """What a scan of `n` beams from the pose (x, y, theta), m and rad, would read in the map as it is.

            scan = mapper.raycast(1.0, 2.0, theta, angle_min=-2.356, angle_increment=0.00436, n=1081).range

        The ray k has the bearing theta + (angle_min + k * angle_increment). It ends where it enters the first
        cell that is not free, at the latest at the map's edge, or after `max_range` m; with `unknown="pass"`
        only occupied cells end it. It is what `MapGrid.raycast` makes of the same cells.

        Raises:
            MapperError: a number is out of its range, the point lies outside the map, or the map is empty
                ("map-empty").
        """
        given = {
            "x": x,
            "y": y,
            "theta": theta,
            "angle_min": angle_min,
            "angle_increment": angle_increment,
            "n": n,
            "range_max": max_range,
        }
        parameters = {**texts(given), "unknown": unknown}
        reply = read_reply(RaycastReply, "raycast", self._transport.fetch("raycast", parameters))
        if len(reply.ranges) != n or len(reply.ends) != n or not _ENDS.keys() >= set(reply.ends):
            told = printable(f"{len(reply.ranges)} ranges, ends {sorted(set(reply.ends))}")
            raise BadReply(f"raycast: a range and an end are needed of each of {n} rays, got {told}")
        found = np.array([_ENDS[end] for end in reply.ends], np.str_)
        return Rays(np.array(reply.ranges, np.float64), found)

    def check(
        self,
        points: ArrayLike | None = None,
        *,
        footprints: Sequence[ArrayLike] | None = None,
        margin: float = 0.0,
    ) -> NDArray[np.str_]:
        """Whether points (x, y), or the polygons of `footprints`, m, are free: see `MapGrid.check`.

        The mapper looks, at its map of this moment, and sends no map. A question may have 64 KB: some 1500
        points.

        Raises:
            BadParameter: not one of the two is given, or it is something else.
            MapperError: there are too many, or they meet too many cells.
        """
        asked = footprints_of(points, footprints)
        said = {"points": [point for (point,) in asked]} if footprints is None else {"footprints": asked}
        body = json.dumps({**said, "margin": float(margin)}, separators=(",", ":")).encode()
        states = read_reply(CheckReply, "check", self._transport.ask("check", body)).states
        if len(states) != len(asked) or not set(STATES.values()) >= set(states):
            told = printable(f"{len(states)}, {sorted(set(states))}")
            raise BadReply(f"check: a state is needed of each of {len(asked)}, got {told}")
        return np.array(states, np.str_)

    def distance(
        self, region: ArrayLike | None = None, *, max_distance: float | None = None, at: str | None = None
    ) -> MapLayer:
        """How far the nearest occupied cell of the map is, of every cell: metres between centres, float32.

        Of the whole map, or of the part of it that covers `region`: (xmin, ymin, xmax, ymax), m, to what is
        occupied around it, too; else as `MapGrid.distance`. With a small `max_distance` a part costs the
        mapper little. A map without a known cell has shape (0, 0). `at`: of the map as it was saved under
        that name.

        Raises:
            MapperError: the region is inverted, not finite, or wholly outside the map, or `max_distance` is
                not 0.001 to 1000 m; or no map is saved under the name ("unknown-snapshot").
        """
        given = texts({"region": region, "max_distance": max_distance, "at": at})
        return self._fetched_layer(DISTANCE, "distance.npz", given)

    def inflate(self, radius: float, region: ArrayLike | None = None, *, at: str | None = None) -> MapLayer:
        """The map's trinary states, int8, with all occupied, 100, within `radius` m of an occupied cell.

        Of the whole map, of a part of it, or of one that was saved, as `distance`; else as `MapGrid.inflate`.

        Raises:
            MapperError: the region is inverted, not finite, or wholly outside the map, or the radius is not 0
                to 100 m; or no map is saved under the name ("unknown-snapshot").
        """
        given = texts({"region": region, "radius": radius, "at": at})
        return self._fetched_layer(OCCUPANCY, "inflate.npz", given)

    def _fetched_layer(self, array: str, name: str, given: dict[str, str]) -> MapLayer:
        reply = self._transport.fetch_map(given, name)
        try:
            values, place = read_layer_npz(reply.npz, array, max_bytes=self._max_bytes)
        except BadInput as error:
            raise BadReply(str(error)) from error
        epoch, run, revision = reply.version
        return MapLayer(values, *place, epoch, revision, reply.stamp, run)
