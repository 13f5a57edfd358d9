"""Damaged files, by the thousand: every kind of file that people give, made whole, mutated, and read again.

`python tests/mutated_files.py SECONDS [SEED]` tries as many as fit into that time, in a process of limited
memory, and prints what every reader said, by kind. Whatever is no `OgmError` ends it with a traceback, and so
does what takes a minute; the files are left in the folder that is named.
"""

import faulthandler
import gzip
import io
import json
import random
import re
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from bag_files import read_bag
from mutations import mutated
from ogm_client import MapGrid
from ogm_core.errors import OgmError
from ogm_core.files.map_files import encode_npz
from ogm_core.files.ros_map_reader import read_ros_map
from ogm_core.files.ros_map_writer import write_pgm
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.logs.recordings import RecordingReader
from ogm_core.ros2.mcap_recording import McapWriter
from ogm_core.simulation.catalogue import world_named
from ogm_core.types import Pose, PoseStamped, Scan
from ogm_services.mapper.live.start_map import started_grid
from ogm_services.recorder.repair import repair_recording
from ogm_services.ros2.mcap_reader import McapReader, holds_recording
from ogm_services.settings.settings import Settings
from whole_bags import whole_bags

MEMORY = 3 * 1024**3
"""What readers may take of address space, bytes, beside what the process has before."""
PATIENCE = 60.0
"""How long one file may take, s, on a machine that is busy."""
GRID_YAML = (
    b"mode: trinary\nresolution: 0.05\norigin: [-1.0, -1.0, 0.0]\n"
    b"negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\nimage: "
)
WORLD = b"""name: hall
boxes: [[0, 0, 12, 8], [4, 3, 5, 5]]
walls: &w
  - [2, 0, 2, 2.5]
  - [6.5, 8, 6.5, 5.5]
circles: [[8, 4, 0.4], [10.5, 6.5, 0.2]]
path: {waypoints: [[1, 1], [1, 4], [3, 4], [3, 1.2]], spacing: 0.1}
"""
ROUND = WORLD[: WORLD.index(b"path")] + b"path: {circle: [6, 4, 1.5], poses: 200}\n"


@dataclass(frozen=True)
class Reader:
    """A kind of file and who reads it: `files` by name, whole; `read` takes the path of the first of them."""

    files: dict[str, bytes]
    read: Callable[[Path], object]

    @property
    def name(self) -> str:
        """The file that is read."""
        return next(iter(self.files))

    def outcome(self, folder: Path) -> str:
        """What the reader makes of the files in a folder: "read", or the class of the error."""
        try:
            self.read(folder / self.name)
        except OgmError as error:
            refusal = error
        else:
            return "read"
        assert 10 < len(str(refusal)) < 2000 + 2 * len(str(folder)), f"no clear line: {str(refusal)[:5000]}"
        return type(refusal).__name__


def _read_log(path: Path, **options: bool) -> None:
    with RecordingReader(path, **options) as reader:
        for _ in reader:
            pass


def _read_world(path: Path) -> None:
    world_named(str(path)).path.pose(1)


def _start(path: Path) -> None:
    started_grid(Settings.model_validate({"mapper": {"start_map": path}}), "epoch").snapshot()


def _load(path: Path) -> None:
    MapGrid.load(path).to_png()


def _lines() -> Iterator[dict[str, object]]:
    pose = {"type": "pose", "robot": "r1", "x": 0.1, "y": 0.5, "theta": 0.1}
    scan = {"type": "scan", "robot": "r1", "sensor": "laser", "ranges": [2.5, "inf", 3.1, "nan", 4.0, 1.25]}
    scan |= {"angle_min": -1.5, "angle_increment": 0.5, "range_min": 0.1, "range_max": 8.0, "run": "a"}
    scan |= {"time_increment": 1e-4, "mount": [0.1, 0.0, 0.2], "pose": [0.1, 0.2, 0.3]}
    for k in range(6):
        yield pose | {"stamp": 10**9 * k, "seq": k}
        yield scan | {"stamp": 10**9 * k}


def _carmen() -> bytes:
    ranges = " ".join(f"{2 + k % 7 / 10:.2f}" for k in range(180))
    flaser = f"FLASER 180 {ranges} 1.0 2.0 0.1 0.9 2.0 0.1 {{t:.2f}} host {{t:.2f}}"
    setup = "0 -1.57 3.14 0.0175 80.0 0.01 0 5 1.0 2.0 3.0 4.0 5.0 0"
    robot = f"ROBOTLASER1 {setup} 1 2 0.1 1 2 0.1 0 0 0.3 0.3 1.0 {{t:.2f}} host {{t:.2f}}"
    odom = "ODOM {t:.2f} 2.0 0.1 0.5 0 0 {t:.2f} host {t:.2f}"
    lines = ["# made by hand", "PARAM laser_front_laser_resolution 1.0"]
    lines += [line.format(t=0.5 * k) for k in range(5) for line in (odom, flaser, robot)]
    return "\n".join(lines).encode() + b"\n"


def _graph() -> bytes:
    laser = next(line for line in _carmen().decode().splitlines() if line.startswith("ROBOTLASER1"))
    lines = [f"VERTEX2 {k} {0.1 * k} 2.0 0.1\n{laser}\nEDGE2 0 {k} 1 0 0 1 0 0 1 0 1" for k in range(5)]
    return "\n".join(lines).encode()


def _mcap() -> bytes:
    file = io.BytesIO()
    writer = McapWriter(file)
    for k in range(20):
        writer.pose("r1", PoseStamped(k, Pose(0.1, 0.5, 0.1), k, "a"), k)
        writer.scan("r1", "laser", Scan(k, -1.5, 0.5, 0.1, 8.0, np.ones(9, np.float32), seq=k, run="a"), k)
        if k % 5 == 0:
            writer.flush()
    writer.finish()
    return file.getvalue()


def _read_mcap(path: Path) -> None:
    holds_recording(path)
    with McapReader(path) as reader:
        for _ in reader:
            pass


def _grid() -> OccupancyGrid:
    grid = OccupancyGrid(GridSettings(), "epoch")
    ranges = np.linspace(1.0, 3.0, 180).astype(np.float32)
    grid.integrate(Scan(0, -1.5, 0.02, 0.1, 8.0, ranges), Pose(0.0, 0.0, 0.0))
    return grid


def _picture(mode: str) -> bytes:
    greys = np.random.default_rng(5).choice(np.array([0, 205, 254], np.uint8), (30, 40))
    greys[5:25, 5:35] = 254
    if mode == "P5":
        return write_pgm(greys)
    if mode == "P2":
        return b"P2\n40 30\n255\n" + "\n".join(" ".join(map(str, row)) for row in greys).encode()
    file = io.BytesIO()
    Image.fromarray(greys).convert(mode).save(file, "PNG")
    return file.getvalue()


def readers() -> dict[str, Reader]:
    """Every kind of file that is read, by what a user calls it."""
    jsonl = "".join(json.dumps(line) + "\n" for line in _lines()).encode()
    carmen, npz = _carmen(), {"map.npz": encode_npz(_grid().snapshot())}
    pictures = {"PGM": "P5", "plain PGM": "P2", "PNG": "L", "RGBA PNG": "RGBA", "palette PNG": "P"}
    maps = {
        kind: {"map.yaml": GRID_YAML + b"picture", "picture": _picture(mode)}
        for kind, mode in pictures.items()
    }
    return {
        "map.npz": Reader(npz, _load),
        "start map, npz": Reader(npz, _start),
        "start map, ROS": Reader(maps["PGM"], _start),
        **{f"ROS map, {kind}": Reader(files, read_ros_map) for kind, files in maps.items()},
        "world of a ROS map": Reader(maps["PGM"], _read_world),
        "world": Reader({"world.yaml": WORLD}, _read_world),
        "round world": Reader({"world.yaml": ROUND}, _read_world),
        "JSON lines": Reader({"a.jsonl": jsonl}, _read_log),
        "JSON lines, packed": Reader({"a.jsonl.gz": gzip.compress(jsonl)}, _read_log),
        "CARMEN": Reader({"a.log": carmen}, _read_log),
        "CARMEN, packed": Reader({"a.clf.gz": gzip.compress(carmen)}, _read_log),
        "CARMEN, odometry": Reader({"a.log": carmen}, lambda path: _read_log(path, odometry=True)),
        "g2o": Reader({"a.g2o": _graph()}, _read_log),
        "MCAP recording": Reader({"a.mcap": _mcap()}, _read_mcap),
        "MCAP recording, repaired": Reader({"a.mcap": _mcap()}, repair_recording),
        **{kind: Reader(files, read_bag) for kind, files in whole_bags().items()},
    }


def written(rng: random.Random, reader: Reader, folder: Path) -> None:
    """Write a reader's files, one of them mutated; what is packed, as often before it is packed."""
    victim = rng.choice(list(reader.files))
    for name, content in reader.files.items():
        if name != victim:
            damaged = content
        elif name.endswith(".gz") and rng.random() < 0.5:
            damaged = gzip.compress(mutated(rng, gzip.decompress(content)), 1)
        else:
            damaged = mutated(rng, content)
        (folder / name).write_bytes(damaged)


def tried(seconds: float, seed: int, folder: Path) -> dict[str, Counter[str]]:
    """What every reader said, by kind, of mutated files: at least of one of each, and as the time allows."""
    rng, table, end = random.Random(seed), readers(), time.monotonic() + seconds
    said = {kind: Counter() for kind in table}
    while True:
        for kind, reader in table.items():
            written(rng, reader, folder)
            faulthandler.dump_traceback_later(PATIENCE, exit=True)
            said[kind][reader.outcome(folder)] += 1
            faulthandler.cancel_dump_traceback_later()
        if time.monotonic() >= end:
            return said


def _peak_kb() -> int:
    """The most memory that this program has had; `ru_maxrss` may be that of who has started it."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(re.search(r"^VmHWM:\s+(\d+) kB$", status, re.MULTILINE)[1])


def main(seconds: float, seed: int) -> None:
    """Try files in this process, whose memory is limited from here on, and print a table."""
    for reader in readers().values():  # what they load and compile is no file's doing
        with tempfile.TemporaryDirectory() as folder:
            for name, content in reader.files.items():
                (Path(folder) / name).write_bytes(content)
            assert reader.outcome(Path(folder)) == "read", reader.name
    used = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    folder = Path(tempfile.mkdtemp(prefix="mutated-"))
    print(f"seed {seed}, files in {folder}", file=sys.stderr)
    for kind, counts in tried(seconds, seed, folder).items():
        print(f"{kind}: {', '.join(f'{count} {what}' for what, count in counts.most_common())}")
    print(f"memory: {_peak_kb() // 1024} MB")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main(
        float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else random.SystemRandom().randrange(2**32)
    )
