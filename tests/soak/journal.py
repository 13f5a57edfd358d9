"""A mapper that keeps a journal of what it integrates: `python -m tests.soak.journal FILE FLAG...`."""

import sys
from pathlib import Path
from typing import IO, Any

from ogm_core.types import Pose, Scan
from ogm_services.__main__ import main
from ogm_services.mapper.service import MapperService


def keep(journal: IO[str]) -> None:
    """Have this process's mapper write a line for each scan that is in its map."""
    construct = MapperService.__init__

    def constructed(service: MapperService, *settings: Any) -> None:
        construct(service, *settings)
        integrate = service.live_map.integrate

        def kept(scan: Scan, pose: Pose, *rest: Any, **more: Any) -> int:
            updates = integrate(scan, pose, *rest, **more)
            journal.write(f"{scan.run} {scan.seq} {pose.x!r} {pose.y!r} {pose.theta!r}\n")
            return updates

        service.live_map.integrate = kept  # type: ignore[method-assign]

    MapperService.__init__ = constructed  # type: ignore[method-assign]


if __name__ == "__main__":
    with Path(sys.argv[1]).open("w", buffering=1, encoding="utf-8") as file:
        keep(file)
        sys.argv = ["ogm", "mapper", *sys.argv[2:]]
        main()
