"""`ogm repair`: a new store of what is intact in a damaged one."""

from pathlib import Path

import typer

from ogm_services.mapper.storage.repair import Repaired, repair

_MOST_LISTED = 50


def run_repair(folder: Path, out: Path) -> None:
    """Save what is intact of the store in `folder` into `out`, and tell what is not.

    Raises:
        OgmError: as `repair`.
    """
    for line in report(repair(folder, out), out):
        typer.echo(line)


def report(repaired: Repaired, out: Path) -> list[str]:
    """What was saved and what was lost, line by line."""
    lines = [f"{out}: {repaired.tiles} tiles of the map at revision {repaired.revision}, under a new epoch"]
    if repaired.snapshots:
        lines.append(f"snapshots that cannot be read are not there: {', '.join(repaired.snapshots)}")
    if repaired.exact:
        lines.append("the map is exactly as it was stored")
        return lines
    if repaired.damaged:
        what = "what was known of one robot or more is lost" if repaired.separate else "unknown now"
        lines.append(f"{what}, x and y from and to in metres ({len(repaired.damaged)}):")
        lines += [
            f"  x {area.xmin:.9g} to {area.xmax:.9g}, y {area.ymin:.9g} to {area.ymax:.9g}"
            for area in repaired.damaged[:_MOST_LISTED]
        ]
        if len(repaired.damaged) > _MOST_LISTED:
            lines.append(f"  and {len(repaired.damaged) - _MOST_LISTED} more")
    if repaired.nameless:
        lines.append(f"unknown now, and nothing tells where: {repaired.nameless} tiles")
    if repaired.robots:
        lines.append(f"begun anew: what was known of {', '.join(repaired.robots[:_MOST_LISTED])}")
    if not (repaired.damaged or repaired.nameless):
        lines.append("every tile is intact by itself")
    lines.append("tiles may be older than others: the map is not exactly one that the mapper had")
    return lines
