"""Maps that are written are read value for value by rclpy, by Foxglove's decoder and by mcap-ros2-support."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from ogm_core.ros2 import cdr
from witness import wanted

SECONDS, NANOSECONDS = 1_700_000_000, 123_456_789
STAMP = SECONDS * 10**9 + NANOSECONDS
SHAPES = [(1, 1), (2, 3), (37, 53)]
UPDATE = """std_msgs/Header header
int32 x
int32 y
uint32 width
uint32 height
int8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def cells(shape):
    return np.random.default_rng(shape).integers(-1, 101, shape).astype(np.int8)


def grid_of(shape):
    return cdr.OccupancyGrid(STAMP, "karte", 0.05, (-12.35, 7.9), cells(shape))


def update_of(shape):
    return cdr.OccupancyGridUpdate(STAMP, "karte", 7, 2**31 - 1, cells(shape))


def is_that_grid(read, shape):
    stamp = {"sec": SECONDS, "nanosec": NANOSECONDS}
    origin = {
        "position": {"x": -12.35, "y": 7.9, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    }
    resolution = float(np.float32(0.05))
    height, width = shape
    info = {
        "map_load_time": stamp,
        "resolution": resolution,
        "width": width,
        "height": height,
        "origin": origin,
    }
    data = cells(shape).ravel().tolist()
    assert read == {"header": {"stamp": stamp, "frame_id": "karte"}, "info": info, "data": data}


def is_that_update(read, shape):
    header = {"stamp": {"sec": SECONDS, "nanosec": NANOSECONDS}, "frame_id": "karte"}
    height, width = shape
    size = {"width": width, "height": height}
    assert read == {"header": header, "x": 7, "y": 2**31 - 1, **size, "data": cells(shape).ravel().tolist()}


@pytest.fixture(scope="module")
def grid_definition():
    return get_typestore(Stores.ROS2_KILTED).generate_msgdef(cdr.OCCUPANCY_GRID, ros_version=2)[0]


@pytest.mark.parametrize("shape", SHAPES)
def test_rclpy_reads_maps(rclpy, shape):
    written = cdr.encode_occupancy_grid(grid_of(shape)).hex()
    is_that_grid(rclpy.ask(type=cdr.OCCUPANCY_GRID, cdr=written)["values"], shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_rclpy_reads_updates_of_maps(rclpy, shape):
    wanted(f"{rclpy.environment}-messages")
    written = cdr.encode_occupancy_grid_update(update_of(shape)).hex()
    is_that_update(rclpy.ask(type=cdr.OCCUPANCY_GRID_UPDATE, cdr=written)["values"], shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_foxglove_reads_maps_and_updates(foxglove, grid_definition, shape):
    written = cdr.encode_occupancy_grid(grid_of(shape)).hex()
    is_that_grid(foxglove.ask(definition=grid_definition, cdr=written)["values"], shape)
    written = cdr.encode_occupancy_grid_update(update_of(shape)).hex()
    is_that_update(foxglove.ask(definition=UPDATE, cdr=written)["values"], shape)


@pytest.mark.parametrize("shape", SHAPES)
def test_mcap_ros2_support_reads_maps_and_updates(mcap_ros2_support, grid_definition, shape):
    written = cdr.encode_occupancy_grid(grid_of(shape)).hex()
    asked = {"type": cdr.OCCUPANCY_GRID, "definition": grid_definition, "cdr": written}
    is_that_grid(mcap_ros2_support.ask(**asked)["values"], shape)
    written = cdr.encode_occupancy_grid_update(update_of(shape)).hex()
    asked = {"type": cdr.OCCUPANCY_GRID_UPDATE, "definition": UPDATE, "cdr": written}
    is_that_update(mcap_ros2_support.ask(**asked)["values"], shape)
