"""Placed scans of logs in files, as tasks leave them for each other in the folder of one build.

Scans stay on the disk, which all workers read: what travels with tasks is small, however large the logs are.
"""

import io
import pickle
import secrets
from collections.abc import Iterator
from dataclasses import dataclass, fields
from operator import attrgetter
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.lib.format import header_data_from_array_1_0, write_array_header_1_0
from numpy.typing import NDArray

from ogm_core.lattice import CellRect
from ogm_core.types import PlacedScan, Scan

_FIELDS = tuple(field.name for field in fields(Scan))
_RANGES = _FIELDS.index("ranges")
_values_of = attrgetter(*_FIELDS)


class ScanIndex(NamedTuple):
    """What is known of the scans of a log that a map may take, in order, without a look at their beams."""

    ends: NDArray[np.int64]
    """Where each ends in the file of scans, bytes; it begins where the one before ends."""
    extents: NDArray[np.int64]
    """The rectangle ix, iy, width, height of the cells that each updates, shape (n, 4)."""
    costs: NDArray[np.float64]
    """How much work each is, about, in cells."""
    stamps: NDArray[np.int64]
    robots: NDArray[np.int64]
    """Whose each is: its number among the log's robots."""
    bases: NDArray[np.float64]
    """Where its robot was, m, shape (n, 2)."""


class PlacedLog:
    """The scans of a log as they are placed: written into `file` one by one, and what is known of them."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._rows: list[tuple[int, CellRect, float, int, int, tuple[float, float]]] = []
        self.robots: list[str] = []
        self.held: list[PlacedScan] = []
        """Those that are held out of the map."""

    def __len__(self) -> int:
        return len(self._rows)

    def add(
        self, placed: PlacedScan, extent: CellRect, cost: float, robot: str, base: tuple[float, float]
    ) -> None:
        """Write a scan that updates the cells of `extent`; see `ScanIndex`."""
        if robot not in self.robots:
            self.robots.append(robot)
        self._file.write(_packed(placed))
        whose = self.robots.index(robot)
        self._rows.append((self._file.tell(), extent, cost, placed.scan.stamp, whose, base))

    def index(self) -> ScanIndex:
        """What is known of the scans."""
        rows = zip(*self._rows, strict=True) if self._rows else [()] * 6
        ends, extents, costs, stamps, robots, bases = rows
        return ScanIndex(
            np.array(ends, np.int64),
            np.array(extents, np.int64).reshape(-1, 4),
            np.array(costs, np.float64),
            np.array(stamps, np.int64),
            np.array(robots, np.int64),
            np.array(bases, np.float64).reshape(-1, 2),
        )


@dataclass(frozen=True)
class ScanFiles:
    """The files of a build in its folder, of each log by its number. Only whole ones have their names."""

    folder: Path

    def new(self) -> Path:
        """A file to write into, which `name` then gives its name."""
        return self.folder / f"part-{secrets.token_hex(8)}"

    def name(self, part: Path, name: str) -> None:
        """Give a file its name; a task that was done twice replaces what it wrote."""
        part.replace(self.folder / name)

    def write(self, name: str, content: bytes) -> None:
        """Write a whole file."""
        part = self.new()
        part.write_bytes(content)
        self.name(part, name)

    def write_log(self, log: int, part: Path, placed: PlacedLog) -> None:
        """Name the file into which a log's scans were written, and write what is known of them."""
        self.name(part, f"scans-{log}")
        self.write_arrays(f"index-{log}", placed.index()._asdict())
        self.write(f"held-{log}", pickle.dumps(placed.held, pickle.HIGHEST_PROTOCOL))

    def index_of(self, log: int) -> ScanIndex:
        """What is known of a log's scans."""
        return ScanIndex(**self.arrays(f"index-{log}"))

    def scans(
        self, log: int, index: ScanIndex, wanted: NDArray[np.bool_]
    ) -> Iterator[tuple[int, PlacedScan]]:
        """The scans of a log that are wanted, in order, each with its number."""
        numbers = np.flatnonzero(wanted)
        begins = np.concatenate(([0], index.ends))[numbers].tolist()
        with (self.folder / f"scans-{log}").open("rb") as file:
            for number, begin, end in zip(
                numbers.tolist(), begins, index.ends[numbers].tolist(), strict=True
            ):
                if file.tell() != begin:
                    file.seek(begin)
                yield number, _unpacked(file.read(end - begin))

    def held(self, log: int) -> list[PlacedScan]:
        """The scans of a log that are held out."""
        return list(_unpickled((self.folder / f"held-{log}").read_bytes()))

    def write_arrays(self, name: str, arrays: dict[str, NDArray[Any]]) -> None:
        """Write small arrays under a name."""
        packed = io.BytesIO()
        np.savez(packed, **arrays)  # type: ignore[arg-type]
        self.write(name, packed.getvalue())

    def arrays(self, name: str) -> dict[str, NDArray[Any]]:
        """The arrays of this name."""
        with np.load(self.folder / name, allow_pickle=False) as arrays:
            return dict(arrays)

    def write_large(self, name: str, array: NDArray[Any]) -> None:
        """Write an array that may be large under a name."""
        # Not by np.save, whose error on a full disk does not say that it is full.
        part, array = self.new(), np.ascontiguousarray(array)
        with part.open("wb") as file:
            write_array_header_1_0(file, header_data_from_array_1_0(array))
            file.write(array.data)
        self.name(part, name)

    def large(self, name: str) -> NDArray[Any]:
        """The array of this name, of which those parts are read that are looked at."""
        # Private, not read-only, for which kernels would have to be compiled once more.
        return np.asarray(np.load(self.folder / name, mmap_mode="c", allow_pickle=False))


def _packed(placed: PlacedScan) -> bytes:
    """A placed scan as bytes: in less than half the time that it takes to pickle it as it is."""
    values = list(_values_of(placed.scan))
    values[_RANGES] = placed.scan.ranges.tobytes()
    return pickle.dumps((values, *placed[1:]), pickle.HIGHEST_PROTOCOL)


def _unpacked(content: bytes) -> PlacedScan:
    """The scan that `_packed` has made bytes of."""
    values, pose, sweep = _unpickled(content)
    values[_RANGES] = np.frombuffer(values[_RANGES], np.float32)
    return PlacedScan(Scan(*values), pose, sweep)


def _unpickled(content: bytes) -> Any:  # noqa: ANN401 - whatever was pickled
    """What was pickled: by this build alone, in a folder that is its user's own."""
    return pickle.loads(content)
