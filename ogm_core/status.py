"""What a mapper says of itself: its status, and the maps that it has saved, as they stand in JSON.

Name by name and in this order.

A field that is added later gets a default value, so that whoever reads the status of an older mapper has one.
"""

import json
from dataclasses import dataclass, field, fields
from typing import Any

from ogm_core.types import Pose

_ONLY_OF_SOME = {"robots", "store", "share", "of_others", "shares", "complete", "missing"}
"""Fields that the JSON has where they say something, and else has not."""
GONE_AFTER = 60.0
"""How long a robot that is not alive is shown after its last message, s."""


@dataclass(frozen=True, slots=True)
class ScansOfOthers:
    """Scans that another share of the map counts, because their sensor stood in that one.

    `border`: those that may reach into this share; `border_dropped`: those of them that it has not taken, for
    want of memory; `elsewhere`: those that cannot.
    """

    border: int = 0
    border_dropped: int = 0
    elsewhere: int = 0


@dataclass(frozen=True, slots=True)
class ScanCounts:
    """Scans of all robots: received = integrated + pending + the sum of those dropped, at every moment.

    In a share of a map that is cut `of_others` are part of that sum, and the JSON of other mappers has none.

    Not part of those received: `lost` ones, which never arrived and cannot be had again, as the gaps in their
    sources' seqs tell; and `replayed` ones, which came again after it was decided what becomes of them.
    `beams_on_robots` are beams of integrated scans that were skipped because they ended at another robot.
    """

    received: int
    integrated: int
    pending: int
    dropped: dict[str, int]
    """How many will never be in the map, by reason; another mapper may know other reasons."""
    lost: int = 0
    replayed: int = 0
    beams_on_robots: int = 0
    of_others: ScansOfOthers | None = None


@dataclass(frozen=True, slots=True)
class PoseCounts:
    """Poses of all robots: those that arrived, and what was odd about some of them.

    `late`, `outlier`, `superseded`, `malformed` and `refused` ones, those of one robot too many, are not
    used; with a `restarted` one a robot's time begins anew, and an `ambiguous` one has the stamp of another
    that says something else. `lost` and `replayed` ones are not part of those received, as with scans.
    """

    received: int
    malformed: int
    late: int
    restarted: int = 0
    ambiguous: int = 0
    outlier: int = 0
    superseded: int = 0
    refused: int = 0
    lost: int = 0
    replayed: int = 0

    @property
    def odd(self) -> dict[str, int]:
        """What was odd about how many of those received, without what was odd about none."""
        names = [field.name for field in fields(self) if field.name not in ("received", "lost", "replayed")]
        return {name: count for name in names if (count := getattr(self, name))}


@dataclass(frozen=True, slots=True)
class OtherCounts:
    """Messages that are neither poses nor scans."""

    ignored: int


@dataclass(frozen=True, slots=True)
class SourceStatus:
    """The scans of one sensor; `run` and `last_seq` are those of the last one taken from the queue.

    `dropped` holds the reasons that occurred, with counts; `hints` names what looks wrong with its data;
    `lost` are those that never arrived; `beams_on_robots` and `of_others` as in `ScanCounts`.
    """

    run: str
    last_seq: int | None
    received: int
    pending: int
    integrated: int
    dropped: dict[str, int] = field(default_factory=dict)
    hints: list[str] = field(default_factory=list)
    lost: int = 0
    beams_on_robots: int = 0
    of_others: ScansOfOthers | None = None


@dataclass(frozen=True, slots=True)
class RobotStatus:
    """Where a robot was last said to be (x and y in m, theta in rad), when (ns), and its sensors by name.

    `alive`: whether its liveliness token is there; `age_s`: seconds since its last message of any kind.
    """

    pose: Pose | None
    stamp: int | None
    alive: bool = False
    age_s: float | None = None
    sources: dict[str, SourceStatus] = field(default_factory=dict)

    @property
    def gone(self) -> bool:
        """Whether it is not to be shown any more: not alive, and silent for GONE_AFTER, or all along."""
        if self.alive:
            return False
        if self.age_s is None:  # a robot of before a restart, or that went without a message
            return self.pose is None
        return self.age_s > GONE_AFTER


@dataclass(frozen=True, slots=True)
class MessageCounts:
    """What came in, and what became of it: the part of a status that is counted message by message."""

    scans: ScanCounts
    poses: PoseCounts
    other: OtherCounts
    robots: dict[str, RobotStatus]


@dataclass(frozen=True, slots=True)
class MapInfo:
    """The map's size: cells that are known, bytes allocated, width and height in cells, resolution in m.

    `robots` are those in a map that keeps robots apart, by name; the JSON of other maps has none.
    """

    known_cells: int
    bytes: int
    width: int
    height: int
    resolution: float
    robots: list[str] | None = None


@dataclass(frozen=True, slots=True)
class StoreInfo:
    """The map on disk: the revision that was stored last, None before the first, and the bytes of its files.

    `failing` says why the map is not stored at present, None while it is.
    """

    revision: int | None
    failing: str | None
    bytes: int


@dataclass(frozen=True, slots=True)
class SnapshotInfo:
    """A map that was saved under a name: which one it is (`epoch`, `run`, `revision`), and its newest stamp.

    `saved` is when, ns since the Unix epoch, and `bytes` what its file takes. `damage` says what is wrong
    with the file, None of most; the map is not known then.
    """

    name: str
    epoch: str
    run: str
    revision: int
    stamp: int | None
    saved: int
    bytes: int
    damage: str | None = None


@dataclass(frozen=True, slots=True)
class SnapshotList:
    """The maps that are saved, by name."""

    snapshots: list[SnapshotInfo]


@dataclass(frozen=True, slots=True)
class Erasure:
    """What has been erased: which map it is since, and how many known cells are unknown now."""

    epoch: str
    run: str
    revision: int
    cells: int


@dataclass(frozen=True, slots=True)
class ShareInfo:
    """Which share of a map that is cut a mapper has: `index` of so many `shares`; cuts and bounds in m.

    `bounds` are xmin, ymin, xmax, ymax, each None where the share is open.
    """

    index: int
    shares: int
    cuts_x: list[float]
    cuts_y: list[float]
    bounds: list[float | None]


@dataclass(frozen=True, slots=True)
class MissingPart:
    """A share of a map that is missing in it: its bounds as in `ShareState`, and since when, ns."""

    share: int
    bounds: list[float | None]
    since: int


@dataclass(frozen=True, slots=True)
class ShareState:
    """How a gateway finds a share of its map: `state` is "up", "missing", or "not storing".

    `bounds` are xmin, ymin, xmax and ymax, m, None where it is open; `since` when it was noticed that it is
    missing, ns since the Unix epoch. Epoch, run and revision are those that are held of it, None before it
    has told anything; `overload` counts the scans that it has dropped for want of time, and `restored` is
    that of its status. `detail` says why it is not taken, or does not store.
    """

    share: int
    bounds: list[float | None]
    state: str
    since: int | None = None
    epoch: str | None = None
    run: str | None = None
    revision: int | None = None
    overload: int | None = None
    restored: bool | None = None
    detail: str | None = None


@dataclass(frozen=True, slots=True)
class Forgotten:
    """What a map is once a robot was left out of it: which one, and the robots that are still in it."""

    epoch: str
    run: str
    revision: int
    robots: list[str]


@dataclass(frozen=True, slots=True)
class Status:
    """A mapper's status; `stamp` is the largest one integrated, ns, None if there is none.

    `run` is the id of the mapper's process, "" of an older one that has none. `threads` update the cells of a
    large scan. `restored`: whether the map was in the mapper's store when it started, or was begun then; None
    of a gateway, and of an older mapper. `store` is that of a mapper which stores its map, `share` that of
    one which has a share of a map; the JSON of others has none. Of a gateway alone there are `shares`, and
    `complete`: whether all of them have told how they are, and none has dropped scans that others have.
    """

    map: str
    epoch: str
    revision: int
    stamp: int | None
    scans: ScanCounts
    poses: PoseCounts
    other: OtherCounts
    map_info: MapInfo
    robots: dict[str, RobotStatus]
    uptime_s: float
    run: str = ""
    threads: int = 1
    restored: bool | None = None
    store: StoreInfo | None = None
    share: ShareInfo | None = None
    shares: list[ShareState] | None = None
    complete: bool | None = None
    missing: list[MissingPart] | None = None


def encode_status(status: Status | SnapshotInfo | SnapshotList | Erasure | Forgotten) -> bytes:
    """JSON form of a status, of what is said of saved maps, or of what has been erased or left out."""
    return json.dumps(status, default=_by_name).encode()


def _by_name(part: Any) -> dict[str, Any]:  # noqa: ANN401 (whichever of the dataclasses above)
    said = {field.name: getattr(part, field.name) for field in fields(part)}
    for name in _ONLY_OF_SOME & said.keys():
        if said[name] is None:
            del said[name]
    return said
