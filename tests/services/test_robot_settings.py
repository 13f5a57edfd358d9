"""Settings of robots, and the three ways of `deskew`: from the file, the environment and flags."""

import pytest

from ogm_core.errors import BadSetting
from ogm_core.placing.robot_rules import RobotRule
from ogm_core.types import Pose
from ogm_services.settings.robots import RobotSettings
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import load_settings


@pytest.fixture
def loaded(tmp_path):
    def load(file="", robots=(), environ=None):
        path = tmp_path / "settings.yaml"
        path.write_text(file)
        return load_settings(config=path, flags={}, environ=environ or {}, robots=robots)

    return load


def test_robots_from_everywhere_flags_first(loaded):
    found = loaded(
        "robots: [{match: r3, origin: [1, 2, 3], radius: 1}]",
        ["r1:origin=0.5,-1,3.14,name=cart,radius=0.25"],
        {"OGM_ROBOTS": "r2:name=b"},
    )
    assert found.robots == (
        RobotSettings(match="r1", origin=Pose(0.5, -1.0, 3.14), name="cart", radius=0.25),
        RobotSettings(match="r2", name="b"),
        RobotSettings(match="r3", origin=Pose(1.0, 2.0, 3.0), radius=1.0),
    )
    assert found.robot_rules() == [RobotRule("r1", 0.25), RobotRule("r2"), RobotRule("r3", 1.0)]


def test_what_is_wrong_is_refused_by_name(loaded):
    for text, words in {
        "r1:origin=1,2": r"robots.origin: three finite numbers X,Y,THETA .*got '1,2' \(--robot\)",
        "r1:orgin=1,2,3": r"robots.orgin: unknown setting \(did you mean origin\?\) \(--robot\)",
        "r1:name=a/b": "robots.name 'a/b': a name is",
        "r1:radius=0": "robots.radius: .*greater than 0, got '0'",
        "r1:radius=101": "robots.radius: .*100, got '101'",
        "r1:radius=wide": "robots.radius: .*got 'wide'",
        "r1": "robots: GLOB:KEY=VALUE,... is needed, got 'r1'",
    }.items():
        with pytest.raises(BadSetting, match=words):
            loaded(robots=[text])
    with pytest.raises(BadSetting, match="robots: a list of mappings is needed"):
        loaded("robots: {match: a}")
    with pytest.raises(BadSetting, match=r"robots.radius: a number is needed, got True"):
        loaded("robots: [{match: a, radius: true}]")


def test_what_is_printed_reads_back(tmp_path):
    settings = Settings(
        robots=({"match": "r*", "origin": [1, 2, 3], "radius": 0.3},),
        sensors=({"match": "a/*", "beyond": "clear"},),
    )
    (tmp_path / "printed.yaml").write_text(settings.to_yaml())
    assert load_settings(config=tmp_path / "printed.yaml", flags={}, environ={}) == settings


@pytest.mark.parametrize(
    ("text", "meant"),
    [("off", "off"), ("no", "off"), ("Auto", "auto"), ("true", "auto"), ("reversed", "reversed")],
)
def test_deskew_by_yaml_and_by_flag(loaded, text, meant):
    (from_file,) = loaded(f"sensors: [{{match: 'a/*', deskew: {text}}}]").sensors
    (from_flag,) = load_settings(config=None, flags={}, environ={}, sensors=[f"a/*:deskew={text}"]).sensors
    assert from_file == from_flag
    assert from_file.rule().deskew == meant


def test_another_deskew_is_refused(loaded):
    with pytest.raises(BadSetting, match=r"sensors.deskew: .*'auto', 'off' or 'reversed'.*got 'on2'"):
        loaded("sensors: [{match: 'a/*', deskew: on2}]")
