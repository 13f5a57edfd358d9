"""Fetch of a mapper's map in ROS 2's terms, over Zenoh, as often as it has changed."""

import math
import re
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import numpy as np
import orjson
import zenoh
from numpy.typing import NDArray

from ogm_client.errors import BadReply, MapperError
from ogm_client.map_client import DEFAULT_MAX_BYTES
from ogm_client.session import NetworkConfig
from ogm_client.transport import Limits, json_object
from ogm_client.zenoh_transport import ZenohTransport
from ogm_core.cells.classes import FREE, GREY_FREE, GREY_OCCUPIED, OCCUPIED, UNKNOWN
from ogm_core.ros2.cdr import OccupancyGrid

TIMEOUT = 10.0
"""How long an answer may take, s: a large map comes over a slow link."""
_COARSE: Final = {"resolution": "coarse"}
"""Of a map that counts the cells that its mapper was told, as map.pgm has them, not their halves."""
_PGM = re.compile(rb"P5\n(?:#[^\n]*\n)*(\d{1,9}) (\d{1,9})\n255\n")
_EMPTY = "map-empty"
_CELLS = np.array(
    [{GREY_FREE: FREE, GREY_OCCUPIED: OCCUPIED}.get(grey, UNKNOWN) for grey in range(256)], np.int8
)


class MapVersion(NamedTuple):
    """One state of a map."""

    epoch: str
    run: str
    revision: int


class MapFetch:
    """Asks the mapper of a map on an open session."""

    def __init__(self, session: zenoh.Session, map_name: str, frame: str) -> None:
        """`frame`: what ROS 2 calls the frame that the map is in."""
        limits = Limits(TIMEOUT, DEFAULT_MAX_BYTES)
        self._transport = ZenohTransport(NetworkConfig(), map_name, limits, session)
        self._frame = frame

    def version(self) -> MapVersion:
        """The state that the map is in.

        Raises:
            ClientError: no mapper answers, or not as a mapper does.
        """
        status = json_object("status", self._transport.fetch("status", {}))
        epoch, run, revision = status.get("epoch"), status.get("run", ""), status.get("revision")
        if not (isinstance(epoch, str) and isinstance(run, str) and isinstance(revision, int)):
            raise BadReply("status: epoch, run and revision are needed")
        return MapVersion(epoch, run, revision)

    def trinary(self) -> OccupancyGrid | None:
        """The map: 0 free, 100 occupied, -1 undecided or unknown; None while no cell is known.

        Raises:
            ClientError: no mapper answers, or not as a mapper does.
        """
        try:
            pgm, said = self._transport.fetch_described("map.pgm", {})
        except MapperError as error:
            if error.type == _EMPTY:
                return None
            raise
        head = _PGM.match(pgm)
        if head is None:
            raise BadReply("map.pgm: a binary PGM of 255 greys is needed")
        width, height = map(int, head.groups())
        if len(pgm) - head.end() != width * height:
            raise BadReply(
                f"map.pgm: {width} x {height} pixels are needed, got {len(pgm) - head.end()} bytes"
            )
        greys = np.frombuffer(pgm, np.uint8, offset=head.end()).reshape(height, width)
        return self._grid(said, _CELLS[greys[::-1]])

    def probabilities(self) -> OccupancyGrid | None:
        """The map: how likely a cell is occupied, 0 to 100, or -1 where unknown; raises as `trinary`."""
        said, cells = self._json()
        return self._grid(said, cells) if cells.size else None

    def without_cells(self) -> OccupancyGrid:
        """What there is to say of a map without a known cell; raises as `trinary`."""
        said, cells = self._json()
        return self._grid(said, cells[:0, :0])

    def _json(self) -> tuple[Mapping[str, Any], NDArray[np.int8]]:
        payload = self._transport.fetch("map.json", _COARSE)
        try:
            said = orjson.loads(payload)
            cells = np.array(said["data"], np.int8).reshape(said["height"], said["width"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise BadReply("map.json: data, width and height are needed") from error
        return said, cells

    def _grid(self, said: Mapping[str, Any], cells: NDArray[np.int8]) -> OccupancyGrid:
        try:
            origin, resolution = said["origin"], float(said["resolution"])
            x, y, stamp = float(origin["x"]), float(origin["y"]), int(said["stamp"] or 0)
        except (KeyError, TypeError, ValueError) as error:
            raise BadReply("map: origin, resolution and stamp are needed") from error
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(resolution) and stamp >= 0):
            raise BadReply("map: finite origin and resolution are needed, and a stamp from 0 on")
        return OccupancyGrid(stamp, self._frame, resolution, (x, y), cells)
