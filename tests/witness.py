"""Programs that others wrote, run beside ours: each in the environment that `make test-ros2` made for it."""

import json
import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MADE = ROOT / "build" / "ros2"
PROGRAMS = Path(__file__).parent / "ros2" / "programs"
ENDED = 60.0
"""How long a program may take to end, s."""


def wanted(*names):
    """Skip the test, with the reason, where one of these environments could not be made."""
    for name in names:
        if not (MADE / f"{name}.made").exists():
            reason = MADE / f"{name}.missing"
            pytest.skip(f"{name}: {reason.read_text().strip() if reason.exists() else 'run make test-ros2'}")


def command(environment, program, *arguments):
    if environment == "npm":
        return ["node", str(PROGRAMS / program), *arguments]
    return [str(MADE / environment / "bin" / "python"), "-u", str(PROGRAMS / program), *arguments]


def start(environment, program, *arguments, settings=None, **options):
    """A process of `program` that sees nothing of this one's environment but `settings`."""
    given = {
        "PATH": os.environ["PATH"],
        "HOME": str(MADE / "home"),
        "LANG": "C.UTF-8",
        "NODE_PATH": str(MADE / "npm" / "node_modules"),
        **(settings or {}),
    }
    options = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "cwd": MADE} | options
    return subprocess.Popen(command(environment, program, *arguments), env=given, **options)


class Answering:
    """A program that answers a line of JSON with a line of JSON, for as long as the `with` block runs."""

    def __init__(self, environment, program, *arguments, settings=None):
        wanted(environment)
        self.environment = environment
        self._process = start(environment, program, *arguments, settings=settings)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """Let it end, as it does when nothing more can be asked."""
        with self._process as process:
            process.stdin.close()
            try:
                process.wait(ENDED)
            finally:
                process.kill()

    def ask(self, **question):
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        assert answer, f"{self._process.args} ended with {self._process.wait()}"
        return json.loads(answer)


def rclpy_node(distribution, domain, name):
    """A node of ROS 2 on DDS, on loopback and without multicast: programs/rclpy_node.py."""
    wanted(f"{distribution}-messages")
    settings = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return Answering(distribution, "rclpy_node.py", name, settings=settings)


def zenoh_node(library, domain, endpoint, name):
    """A node of rmw_zenoh's form: programs/pyzeros_node.py, programs/sdk_node.py."""
    if library == "pyzeros":
        return Answering("zenoh", "pyzeros_node.py", name, str(domain), endpoint)
    wanted("kilted-messages")  # for their definitions
    where = endpoint.rpartition(":")[2], str(MADE / "kilted" / "share")
    return Answering("zenoh", "sdk_node.py", name, str(domain), *where)
