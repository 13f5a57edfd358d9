"""The independent programs that tests of this folder ask; `make test-ros2` installs them."""

import pytest

from witness import Answering


@pytest.fixture(scope="session", params=["jazzy", "kilted"])
def distribution(request):
    return request.param


@pytest.fixture(scope="session")
def rclpy(distribution):
    with Answering(distribution, "rclpy_messages.py") as program:
        yield program


@pytest.fixture(scope="session")
def mcap_ros2_support():
    with Answering("zenoh", "mcap_messages.py") as program:
        yield program


@pytest.fixture(scope="session")
def foxglove():
    with Answering("npm", "foxglove_messages.cjs") as program:
        yield program
