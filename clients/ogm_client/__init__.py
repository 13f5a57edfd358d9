"""The client library: publish a robot's poses and scans, and ask a mapper for its map.

with MapClient("tcp/127.0.0.1:7447") as mapper:
    mapper.get_map().save_png("map.png")
"""

from ogm_client.async_map_client import AsyncMapClient, AsyncMapFollower
from ogm_client.errors import (
    BadReply,
    CannotConnect,
    CannotListen,
    ClientError,
    MapperError,
    NobodyAnswered,
    NotHeard,
    PartialMap,
)
from ogm_client.follower import MapFollower
from ogm_client.map_change import Change
from ogm_client.map_client import MapClient
from ogm_client.map_grid import MapGrid
from ogm_client.map_layer import MapLayer
from ogm_client.missing_shares import MissingShare
from ogm_client.raycast import Ray, Rays
from ogm_client.recording import RecordingWriter
from ogm_client.robot import RobotPublisher
from ogm_core.errors import (
    BadInput,
    BadMapFile,
    BadMessage,
    BadParameter,
    BadRecording,
    BadSetting,
    DiskFull,
    MapEmpty,
    MissingExtra,
    OgmError,
)
from ogm_core.status import RobotStatus, SnapshotInfo, SourceStatus, Status
from ogm_core.wire.keys import DEFAULT_ADDRESS

__all__ = [
    "DEFAULT_ADDRESS",
    "AsyncMapClient",
    "AsyncMapFollower",
    "BadInput",
    "BadMapFile",
    "BadMessage",
    "BadParameter",
    "BadRecording",
    "BadReply",
    "BadSetting",
    "CannotConnect",
    "CannotListen",
    "Change",
    "ClientError",
    "DiskFull",
    "MapClient",
    "MapEmpty",
    "MapFollower",
    "MapGrid",
    "MapLayer",
    "MapperError",
    "MissingExtra",
    "MissingShare",
    "NobodyAnswered",
    "NotHeard",
    "OgmError",
    "PartialMap",
    "Ray",
    "Rays",
    "RecordingWriter",
    "RobotPublisher",
    "RobotStatus",
    "SnapshotInfo",
    "SourceStatus",
    "Status",
]
