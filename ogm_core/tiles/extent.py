"""Extent of a map: which of its lattice's cells it may keep, which are known, and which its limits count."""

from ogm_core.lattice import CellRect

NO_CELLS = CellRect(0, 0, 0, 0)
"""On edges of tiles: a store of it has none."""


class Extent:
    """Rectangles of cells of one map, its writer's; None where there is none.

    A map with a clip takes the scans that the map without one would take: `whole_bounds` and `stretched` are
    that map's, and equal in all maps that took the same scans, whatever their clips are.
    """

    def __init__(self, bounds: CellRect | None, clip: CellRect | None) -> None:
        """Nothing is known yet; `clip` is whole tiles, and some of the bounds lie in it."""
        self.clip = clip
        self.whole_bounds = bounds
        self.bounds = None if bounds is None else self.kept(bounds)
        """What a bounded map keeps."""
        self.known: CellRect | None = None
        """The smallest rectangle that holds every cell that was written, as far as it lies in the clip."""
        self.stretched: CellRect | None = None
        """The same without the clip, but for erasures: they do not lessen it, for what is left of it lies in
        other maps. Without a clip it is what is known."""

    def kept(self, rect: CellRect) -> CellRect:
        """The part of a rectangle that lies in the clip; NO_CELLS if none does."""
        if self.clip is None:
            return rect
        part = rect.intersection(self.clip)
        return part if part.cells else NO_CELLS

    def counted(self, updated: CellRect) -> CellRect:
        """The part of what a scan says that lies in the bounds of the map without a clip."""
        return updated if self.whole_bounds is None else updated.intersection(self.whole_bounds)

    def stretched_by(self, updated: CellRect) -> CellRect:
        """What limits count once these cells are written."""
        return updated if self.stretched is None else self.stretched.union(updated)

    def add(self, kept: CellRect) -> None:
        """These cells, which lie in the clip, are written."""
        self.know(kept if self.known is None else self.known.union(kept))

    def widen(self, stretched: CellRect, known: CellRect | None) -> None:
        """Cells are written: these are what limits count, and what is known, from now on."""
        self.stretched, self.known = stretched, known

    def begin(self, written: CellRect) -> None:
        """A map begins with these cells, wherever they lie."""
        self.stretched = written
        kept = self.kept(written)
        self.know(kept if kept.cells else None)

    def know(self, known: CellRect | None) -> None:
        """These cells are known from now on, as far as they lie in the clip."""
        self.known = known
        if self.clip is None:
            self.stretched = known

    def served(self, spread: int) -> CellRect:
        """The bounds, or what is known, with so many cells more on every side: beyond the clip, too."""
        return _served(self.bounds, self.known, spread)

    def whole(self, spread: int) -> CellRect:
        """What the map without a clip serves, but for erasures."""
        return _served(self.whole_bounds, self.stretched, spread)


def _served(bounds: CellRect | None, known: CellRect | None, spread: int) -> CellRect:
    if bounds is not None or known is None:
        return bounds or NO_CELLS
    return known.widened(spread) if spread else known
