"""Settings of sensors: from the file, the environment and flags; what is wrong is refused by name."""

import pytest

from ogm_core.errors import BadSetting
from ogm_core.placing.sensor_rules import SensorRule
from ogm_core.types import Pose
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import load_settings

EVERY_KEY = """
sensors:
  - match: r1/front
    time_offset: -0.05
    range_min: 0.2
    range_max: 12
    beyond: clear
    clear_range: 3.5
    reach: 10
    ignore_no_return: true
    deskew: false
    mount: [0.1, -0.2, 3.14]
    upside_down: true
  - match: "*"
    range_max: 8
"""
FRONT = SensorRule(
    *("r1/front", -0.05, 0.2, 12.0, "clear", 3.5, 10.0, True, "off"),
    mount=Pose(0.1, -0.2, 3.14),
    upside_down=True,
)


@pytest.fixture
def loaded(tmp_path):
    def load(file="", flags=(), environ=None):
        path = tmp_path / "settings.yaml"
        path.write_text(file)
        return load_settings(config=path, flags={}, environ=environ or {}, sensors=flags)

    return load


def test_every_key_from_a_file(loaded):
    assert loaded(EVERY_KEY).sensor_rules() == [FRONT, SensorRule("*", range_max=8.0)]


def test_every_key_from_a_flag(loaded):
    text = (
        "r1/front:time_offset=-0.05,range_min=0.2,range_max=12,beyond=clear,clear_range=3.5,reach=10,"
        "ignore_no_return=true,deskew=no,mount=[0.1,-0.2,3.14],upside_down=on"
    )
    assert loaded(flags=[text]).sensor_rules() == [FRONT]
    assert loaded(environ={"OGM_SENSORS": f" {text} ; *:range_max=8;"}).sensor_rules() == [
        FRONT,
        SensorRule("*", range_max=8.0),
    ]


def test_flags_come_first_then_the_environment_then_the_file(loaded):
    environ = {"OGM_SENSORS": "b/*:reach=2"}
    rules = loaded(
        "sensors: [{match: c/*, reach: 3}]", ["a/*:reach=1", "aa/*:reach=1"], environ
    ).sensor_rules()
    assert [rule.match for rule in rules] == ["a/*", "aa/*", "b/*", "c/*"]


def test_settings_written_as_a_file_are_read_back(loaded):
    settings = loaded(EVERY_KEY)
    assert loaded(settings.to_yaml()) == settings
    assert Settings().sensor_rules() == []


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("sensors: {match: a/b}", "sensors: a list of mappings is needed"),
        ("sensors: [a]", "sensors: mappings with the key match are needed, got 'a'"),
        ("sensors: [{match: laser, reach: 3}]", r"of a robot's sensor is needed.* got 'laser'"),
        ("sensors: [{reach: 3}]", "sensors.match: field required"),
        ("sensors: [{match: a/b, rang_max: 3}]", r"rang_max: unknown setting \(did you mean range_max\?\)"),
        ("sensors: [{match: a/b, range_max: far}]", "sensors.range_max: .*got 'far'"),
        ("sensors: [{match: a/b, range_max: 1001}]", "sensors.range_max: .*1000.*got 1001"),
        ("sensors: [{match: a/b, range_min: -1}]", "sensors.range_min"),
        ("sensors: [{match: a/b, reach: true}]", "sensors.reach: a number is needed, got True"),
        ("sensors: [{match: a/b, time_offset: .inf}]", "sensors.time_offset: .*finite"),
        ("sensors: [{match: a/b, time_offset: 5.0e+9}]", "sensors.time_offset: .*4000000000.*got 5000000000"),
        ("sensors: [{match: a/b, time_offset: -5.0e+9}]", "sensors.time_offset: .*-4000000000.*got -5"),
        ("sensors: [{match: a/b, upside_down: 1}]", "sensors.upside_down: true or false is needed, got 1"),
        ("sensors: [{match: a/b, beyond: clip}]", "sensors.beyond: .*'skip' or 'clear'"),
        ("sensors: [{match: a/b, mount: [1, 2]}]", r"sensors.mount: three finite numbers"),
        ("sensors: [{match: a/b, range_min: 3, range_max: 3}]", "range_min: it must be below.* 3 and 3"),
        ("sensor: [{match: a/b}]", r"sensor: unknown setting \(did you mean sensors\?\)"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_file_is_refused_by_name(loaded, file, said):
    with pytest.raises(BadSetting, match=said) as caught:
        loaded(file)
    assert "settings.yaml" in str(caught.value)


@pytest.mark.parametrize(
    "text", ["a/b", "a/b:", ":reach=1", "a/b:reach", "a/b:1,reach=2", "a/b:reach=1,reach=2", "a/b:x=1"]
)
def test_what_is_wrong_in_a_flag_or_the_environment_is_refused(loaded, text):
    with pytest.raises(BadSetting, match=r"sensors.*\(--sensor\)"):
        loaded(flags=[text])
    with pytest.raises(BadSetting, match=r"sensors.*\(environment OGM_SENSORS\)"):
        loaded(environ={"OGM_SENSORS": text})
