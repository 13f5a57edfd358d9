"""A client that openapi-python-client has generated, at work: what it is told of a map, as JSON.

python look.py URL FILE.png FILE.npz
"""

import json
import sys
from pathlib import Path

from ogm_http import AuthenticatedClient, Client
from ogm_http.api.changes import erase
from ogm_http.api.map_ import get_map_json, get_map_npz, get_map_png
from ogm_http.api.mapper import get_status
from ogm_http.api.queries import check, get_cell, raycast
from ogm_http.models import (
    CellState,
    CheckReply,
    Erasure,
    OccupancyMap,
    PointsToCheck,
    Problem,
    RaycastReply,
    Status,
)
from ogm_http.types import File


def main(url: str, picture: str, archive: str) -> None:
    """Ask for each thing once, and print what of it the types promise."""
    told: dict[str, object] = {}
    with Client(base_url=url) as client:
        status = get_status.sync(client=client)
        assert isinstance(status, Status)
        told["status"] = [status.map_, status.revision, status.scans.integrated, status.map_info.resolution]
        whole = get_map_json.sync(client=client, values="trinary")
        assert isinstance(whole, OccupancyMap)
        told["map"] = [whole.width, whole.height, whole.origin.x, whole.origin.y, sum(map(abs, whole.data))]
        cell = get_cell.sync(client=client, x=2.25, y=0.25)
        assert isinstance(cell, CellState)
        told["cell"] = [cell.ix, cell.iy, cell.known, cell.probability]
        rays = raycast.sync(client=client, x=0.25, y=0.25, n=2, angle_increment=1.5707963267948966)
        assert isinstance(rays, RaycastReply)
        told["rays"] = [rays.ranges, rays.ends]
        checked = check.sync(client=client, body=PointsToCheck(points=[[0.75, 0.25], [2.25, 0.25]]))
        assert isinstance(checked, CheckReply)
        told["check"] = checked.states
        drawn = get_map_png.sync_detailed(
            client=client, palette="cividis", transparent="1", region="-1,-1,1,1"
        )
        assert isinstance(drawn.parsed, File)
        Path(picture).write_bytes(drawn.content)
        again = get_map_png.sync_detailed(client=client, if_none_match=drawn.headers["ETag"])
        told["again"] = int(again.status_code)
        Path(archive).write_bytes(get_map_npz.sync_detailed(client=client).content)
        refused = raycast.sync(client=client, x=0.25, y=0.25, n=0)
        assert isinstance(refused, Problem)
        told["refused"] = [refused.status, refused.type_, refused.detail]
    with AuthenticatedClient(base_url=url, token="none is needed") as client:
        erased = erase.sync(client=client, region="2,0,2.5,0.5")
        assert isinstance(erased, Erasure)
        told["erased"] = [erased.revision, erased.cells]
    print(json.dumps(told))


if __name__ == "__main__":
    main(*sys.argv[1:])
