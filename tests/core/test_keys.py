"""Keys and the names that may stand in them."""

from typing import get_args

import pytest

from ogm_core.errors import BadSetting
from ogm_core.wire.keys import MapKeys, RobotRun, Service, ShareService, Source, check_name

KEYS = MapKeys("lab")
BAD_NAMES = [None, 7, b"a", "", "a/b", "a b", "*", "**", "$*", "a?b", "a#b", "käse", "a\n", "\n", "a" * 65]


@pytest.mark.parametrize("name", ["a", "A-z_0.9", ".", "robot1", "x" * 64])
def test_a_good_name_is_returned_as_it_is(name):
    assert check_name(name, "robot") == name


@pytest.mark.parametrize("name", BAD_NAMES)
def test_a_bad_name_is_refused_wherever_it_would_stand(name):
    with pytest.raises(BadSetting, match=r"^robot "):
        check_name(name, "robot")
    with pytest.raises(BadSetting, match=r"^map name "):
        MapKeys(name)
    with pytest.raises(BadSetting, match=r"^robot "):
        KEYS.pose(name)
    with pytest.raises(BadSetting, match=r"^robot "):
        KEYS.scan(name, "laser")
    with pytest.raises(BadSetting, match=r"^sensor "):
        KEYS.scan("robot1", name)


def test_keys_are_those_of_the_contract():
    assert KEYS.robots == "ogm/v1/lab/robots/**"
    assert KEYS.pose("r1") == "ogm/v1/lab/robots/r1/pose"
    assert KEYS.scan("r1", "front") == "ogm/v1/lab/robots/r1/scan/front"
    assert KEYS.alive("mapper", "id1", "run1") == "ogm/v1/lab/alive/mapper/id1/run1"
    assert KEYS.truth == "ogm/v1/lab/truth"
    assert [KEYS.service(name) for name in get_args(Service)] == [
        f"ogm/v1/lab/{name}"
        for name in (
            "map",
            "cell",
            "quality",
            "status",
            "snapshots",
            "raycast",
            "check",
            "distance",
            "inflate",
            "reset",
            "erase",
            "forget",
            "save",
            "restore",
            "delete",
        )
    ]


def test_a_token_names_a_robot_and_its_run():
    assert KEYS.robot_of(KEYS.alive("robot", "r1", "run-7")) == RobotRun("r1", "run-7")
    others = KEYS.alive("mapper", "r1", "a"), MapKeys("x").alive("robot", "r1", "a"), KEYS.pose("r1")
    for key in (*others, "ogm/v1/lab/alive/robot/r1", "ogm/v1/lab/alive/robot/r1/a/b", "", "r1"):
        assert KEYS.robot_of(key) is None, key


def test_the_source_of_a_key_is_whom_it_was_made_for():
    assert KEYS.source_of(KEYS.pose("r1")) == Source("r1", None)
    assert KEYS.source_of(KEYS.scan("r1", "front")) == Source("r1", "front")
    # Words of the key expression are names like any other.
    assert KEYS.source_of(KEYS.scan("pose", "scan")) == Source("pose", "scan")


@pytest.mark.parametrize(
    "key",
    [
        "",
        "ogm/v1/lab/map",
        "ogm/v1/lab/robots",
        "ogm/v1/lab/robots/r1",
        "ogm/v1/lab/robots/r1/scan",
        "ogm/v1/lab/robots/r1/pose/x",
        "ogm/v1/lab/robots/r1/scan/front/x",
        "ogm/v1/lab/robots/r1/odometry",
        "ogm/v1/lab/robots//pose",
        "ogm/v1/lab/robots/r 1/pose",
        "ogm/v1/lab/robots/r 1/scan/front",
        "ogm/v1/lab/robots/r1/scan/a b",
        "ogm/v1/lab2/robots/r1/pose",
        "ogm/v2/lab/robots/r1/pose",
        "x/ogm/v1/lab/robots/r1/pose",
    ],
)
def test_a_key_of_something_else_has_no_source(key):
    assert KEYS.source_of(key) is None


def test_a_share_is_asked_by_its_number_or_all_at_once():
    assert KEYS.share(3, "part") == "ogm/v1/lab/shares/3/part"
    assert [KEYS.share("*", name) for name in get_args(ShareService)] == [
        f"ogm/v1/lab/shares/*/{name}" for name in ("part", "status", "reset")
    ]
