"""Writes of a mapper: what changes its map, or what is saved of it."""

import numpy as np
from numpy.typing import ArrayLike

from ogm_client.parameters import texts
from ogm_client.status_reply import read_erasure, read_forgotten, read_snapshot, read_snapshots
from ogm_client.transport import Transport
from ogm_core.errors import BadParameter, cut
from ogm_core.status import SnapshotInfo
from ogm_core.wire.keys import MAX_NAME, NAME


class MapWrites:
    """What a `MapClient` has its mapper change, over the connection that it has."""

    _transport: Transport

    def reset(self) -> None:
        """Empty the map: a new epoch begins."""
        self._transport.write("reset", {})

    def erase(self, region: ArrayLike | None = None, *, polygon: ArrayLike | None = None) -> int:
        """Make cells unknown whose centre lies in `region` or in `polygon`; return how many were known.

        A region is (xmin, ymin, xmax, ymax), m, and a polygon its 3 to 64 corners (x, y) in order, m; where
        it crosses itself it is read even-odd. What lies outside the map is left out. Where the mapper stores
        its map that is on the disk then.

        Raises:
            BadParameter: not one of the two is given, or it cannot be sent.
            MapperError: it is ill-formed, or lies wholly outside the map, or the map is empty ("map-empty").
        """
        if (region is None) == (polygon is None):
            raise BadParameter("region or polygon: one of them is needed, to say where")
        corners = None if polygon is None else _corners(polygon)
        given = texts({"region": region, "polygon": corners})
        return read_erasure(self._transport.write("erase", given)).cells

    def forget(self, robot: str) -> list[str]:
        """Leave a robot out of the map, which is that of all others' scans then; return who is still in it.

        Stop the robot before: scans of it that come later are added anew. Where the mapper stores its map
        that is on the disk then.

        Raises:
            BadParameter: it is no name of a robot: 1 to 64 of A-Z a-z 0-9 _ - .
            MapperError: it is not in the map ("unknown-robot"), or the map does not keep robots apart
                ("not-separate").
        """
        if not (isinstance(robot, str) and NAME.fullmatch(robot)):
            raise BadParameter(f"robot {cut(repr(robot))}: a name is 1 to {MAX_NAME} of A-Z a-z 0-9 _ - .")
        return read_forgotten(self._transport.write("forget", {"robot": robot})).robots

    def snapshots(self) -> list[SnapshotInfo]:
        """The maps that the mapper has saved, by name.

        This, and whatever else is about them, raises MapperError ("not-stored") of a mapper that stores none.
        """
        return read_snapshots(self._transport.fetch("snapshots", {}))

    def save_snapshot(self, name: str) -> SnapshotInfo:
        """Have the mapper save its map of this moment under a name that is not taken.

        Raises:
            BadParameter: it is no name: 1 to 64 of A-Z a-z 0-9 _ - .
            MapperError: the name is taken ("name-taken"), or the mapper's disk is full ("disk-full").
        """
        return read_snapshot(self._transport.write("save", _named(name)))

    def restore_snapshot(self, name: str) -> None:
        """Have the mapper go on with the map that is saved under a name: a new epoch begins.

        It takes as long as writing that map to the disk: give a large one a `timeout` of its own.

        Raises:
            BadParameter: it is no name.
            MapperError: there is none of this name ("unknown-snapshot"), or it cannot be restored.
        """
        self._transport.write("restore", _named(name))

    def delete_snapshot(self, name: str) -> None:
        """Have the mapper delete the map that is saved under a name.

        Raises:
            BadParameter: it is no name.
            MapperError: there is none of this name ("unknown-snapshot").
        """
        self._transport.write("delete", _named(name))


def _named(name: str) -> dict[str, str]:
    if not (isinstance(name, str) and NAME.fullmatch(name)):
        raise BadParameter(f"name {cut(repr(name))}: a name is 1 to {MAX_NAME} of A-Z a-z 0-9 _ - .")
    return {"name": name}


def _corners(polygon: ArrayLike) -> list[float]:
    """The numbers of a polygon's corners, one after the other."""
    try:
        corners = np.asarray(polygon, np.float64)
    except (TypeError, ValueError) as error:
        raise BadParameter(f"polygon: {error}") from error
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise BadParameter(f"polygon: corners (x, y) are needed, got an array of shape {corners.shape}")
    numbers: list[float] = corners.ravel().tolist()
    return numbers
