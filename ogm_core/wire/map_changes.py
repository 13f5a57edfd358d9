"""Map changes: what a mapper tells of its map to a program that has seen an earlier revision of it."""

from collections.abc import Iterator

from ogm_core.snapshot import MapSnapshot
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.wire.map_update import MapUpdate, tiles_at_once


def updates_of(
    snapshot: MapSnapshot, changed: ChangedTiles, prev: int, *, whole: bool = False
) -> Iterator[MapUpdate]:
    """The messages that bring a copy at `prev` to a snapshot, whose `changed` tiles are those since then.

    `whole`: they are all of its tiles. A part is made when it is its turn.
    """
    most = tiles_at_once(snapshot.model.planes)
    parts = max(1, -(-len(changed) // most))
    for part, tiles in enumerate(changed.parts(most)):
        yield MapUpdate(
            epoch=snapshot.epoch,
            run=snapshot.run,
            prev=prev,
            revision=snapshot.revision,
            stamp=snapshot.stamp,
            lattice=snapshot.lattice,
            planes=snapshot.model.planes,
            model=snapshot.model.told,
            extent=snapshot.rect,
            tiles=tiles.places,
            cells=tiles.planes(),
            whole=whole,
            part=part,
            parts=parts,
        )
