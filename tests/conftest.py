"""What tests of several folders share: a loopback endpoint, a session on it, waiting with a deadline.

A deadline says when to give up, never how quick something is: it holds on a machine that is ten times busy.
"""

import errno
import os
import shutil
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from ogm_services.runtime.kernel_cache import kernel_cache

GIVEN_UP = 30.0
"""When `eventually` gives up, s."""


def pytest_configure(config):
    """Keep compiled kernels where `ogm` does; let no example of hypothesis fail because a machine is busy."""
    cache = ExitStack()
    cache.enter_context(kernel_cache())
    config.add_cleanup(cache.close)
    patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.register_profile("busy", patient)
    settings.register_profile("soak", patient, max_examples=10_000)  # pytest --hypothesis-profile soak
    if config.getoption("--hypothesis-profile") is None:
        settings.load_profile("busy")


def pytest_xdist_auto_num_workers():
    """Processes of `pytest -n auto`, three for two cores: many tests wait for processes that they start."""
    return -(-3 * len(os.sched_getaffinity(0)) // 2)


@pytest.fixture
def endpoint():
    """A Zenoh endpoint on loopback that nobody listens on."""
    from ogm_client.session import resolve_listen  # here: the core's tests load no client

    return resolve_listen("tcp/127.0.0.1:0")


@pytest.fixture
def listener(endpoint):
    """An open session that listens on `endpoint`; others connect to it as clients."""
    from ogm_client.session import NetworkConfig, open_session

    with open_session(NetworkConfig(listen=(endpoint,))) as session:
        yield session


@pytest.fixture
def eventually():
    """`eventually(condition)` returns the condition's value once it is true; fails after a deadline, s."""

    def wait(condition, timeout=GIVEN_UP):
        deadline, pause = time.monotonic() + timeout, 0.001
        while not (value := condition()):
            assert time.monotonic() < deadline, f"not within {timeout} s"
            time.sleep(pause)
            pause = min(2 * pause, 0.05)  # to ask more often would slow down what is waited for
        return value

    return wait


@pytest.fixture(scope="session")
def datasets():
    """Folder of recorded data; tests that want it are skipped where it is not."""
    folder = os.environ.get("OGM_DATASETS")
    if not folder:
        pytest.skip(
            "OGM_DATASETS is not set: it names the folder with recorded data, such as intel and ros-maps"
        )
    return Path(folder)


@pytest.fixture(scope="session")
def ros_maps(datasets):
    """Folder of maps in nav2's format."""
    return datasets / "ros-maps"


@pytest.fixture(scope="session")
def intel(datasets):
    """Folder of the recorded building."""
    return datasets / "intel"


@pytest.fixture
def disk_full(monkeypatch):
    """What is written does not reach the disk, which is full."""

    def fsync(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", fsync)


@pytest.fixture(scope="session")
def failing_disk(tmp_path_factory):
    """The library of failing_disk.c."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip(
            "a disk that fails is a library for Linux that a C compiler (cc) makes; there is none here"
        )
    library = tmp_path_factory.mktemp("failing") / "failing_disk.so"
    source = Path(__file__).with_name("failing_disk.c")
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return library
