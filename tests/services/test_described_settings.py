"""`--print-config`: every setting with its origin, as a settings file; and what a log says of settings."""

import numpy as np
import pytest
import yaml
from pydantic import SecretStr
from typer.testing import CliRunner

from ogm_core.errors import BadSetting
from ogm_core.files.map_files import encode_npz, encode_pgm, encode_yaml
from ogm_core.grid import OccupancyGrid
from ogm_core.types import Pose, Scan
from ogm_services.cli import app
from ogm_services.mapper.live.start_map import started_grid
from ogm_services.settings.described import MASKED, _plain, differences
from ogm_services.settings.settings import SECTIONS, Settings
from ogm_services.settings.sources import load_settings
from ogm_services.settings.values import PRESETS


def printed(*args, code=0, **environ):
    ended = CliRunner().invoke(app, [*map(str, args), "--print-config"], env=environ, prog_name="ogm")
    assert ended.exit_code == code, ended
    return ended.stdout


def origins(text):
    """What stands behind every key, by section.key."""
    found, section = {}, ""
    for line in text.splitlines():
        before, _, origin = line.rpartition("  # ")
        if not line.startswith((" ", "-")):
            section = line.partition(":")[0]
        else:
            found[f"{section}.{before.strip(' -#').partition(':')[0]}"] = origin
    return found


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text(
        "map: {preset: lab, alpha: 0.25}\n"
        "mapper: {max_speed: .inf}\n"
        "sensors:\n- {match: '*/scan', mount: [1, 2, 0.5], ignore_no_return: yes}\n"
    )
    return path


def test_every_setting_is_there_with_its_origin(file):
    text = printed("mapper", "--config", file, "--l-max", "5", OGM_MAP__P_OCC="0.8", OGM_LOG__LEVEL="DEBUG")
    found = origins(text)
    wanted = {f"{section}.{key}" for section, kind in SECTIONS.items() for key in kind.model_fields}
    assert wanted <= found.keys()
    assert found["map.resolution"] == f"preset lab, file {file}"
    assert found["map.preset"] == found["map.alpha"] == f"file {file}"
    assert found["map.p_occ"] == "environment OGM_MAP__P_OCC"
    assert found["map.l_max"] == "--l-max"
    assert found["map.reach"] == found["network.listen"] == "default"
    assert found["sensors.match"] == f"file {file}"
    values = yaml.safe_load(text)
    assert (values["map"]["l_max"], values["map"]["p_occ"], values["log"]["level"]) == (5.0, 0.8, "debug")


def test_what_is_printed_is_a_settings_file_of_the_same_settings(file, tmp_path):
    long = "a  b #: " * 20
    (tmp_path / long).write_text("{}")
    flags = ["--config", file, "--listen", "tcp/127.0.0.1:0,tcp/[::1]:7", "--zenoh-config", tmp_path / long]
    flags += ["--sensor", "r/*:deskew=no,range_max=8"]
    again = tmp_path / "again.yaml"
    again.write_text(printed("mapper", *flags, OGM_MAP__REACH="7.5"))
    settings = load_settings(config=again, flags={}, environ={})
    assert settings.map.reach == 7.5
    assert settings.mapper.max_speed == float("inf")
    assert str(settings.network.zenoh_config) == str(tmp_path / long)
    assert [sensor.match for sensor in settings.sensors] == ["r/*", "*/scan"]
    flags = {"network": {"listen": "tcp/127.0.0.1:0,tcp/[::1]:7", "zenoh_config": str(tmp_path / long)}}
    assert settings == load_settings(
        config=file, flags=flags, environ={"OGM_MAP__REACH": "7.5"}, sensors=["r/*:deskew=no,range_max=8"]
    )


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A map of the world lab, of the preset's cells: map.npz, and map.yaml with its picture."""
    folder = tmp_path_factory.mktemp("saved")
    grid = OccupancyGrid(Settings.model_validate({"map": PRESETS["lab"]}).grid_settings(), "e")
    grid.integrate(Scan(0, 0.0, 0.1, 0.1, 8.0, np.full(60, 3.0, np.float32)), Pose(0.0, 0.0, 0.0))
    snap = grid.snapshot()
    (folder / "map.npz").write_bytes(encode_npz(snap))
    (folder / "map.pgm").write_bytes(encode_pgm(snap))
    (folder / "map.yaml").write_bytes(encode_yaml(snap, "map.pgm"))
    return folder


@pytest.mark.parametrize(
    ("start_map", "flags"),
    [
        ("map.npz", ["--cells", "float64", "--sensor", "r/*:deskew=no"]),
        ("map.npz", ["--preset", "lab"]),
        ("map.yaml", ["--start-confidence", "0.85"]),
        ("map.yaml", ["--p-occ", "0.8", "--resolution", "0.1"]),
    ],
)
def test_a_mapper_starts_with_what_is_printed_as_with_what_was_given(saved, tmp_path, start_map, flags):
    """Not so if defaults were given: a start map has a resolution of its own, and an npz no confidence."""
    again = tmp_path / "again.yaml"
    again.write_text(printed("mapper", "--start-map", saved / start_map, *flags))
    settings = load_settings(config=again, flags={}, environ={})
    assert started_grid(settings, "e").settings.resolution == 0.1
    assert printed("mapper", "--config", again).count("default") == again.read_text().count("default")


def test_names_of_files_end_no_comment(tmp_path):
    path = tmp_path / "a\nmap: {l_max: 2}\n#.yaml"
    path.write_text("map: {l_max: 3.0}")
    assert yaml.safe_load(printed("mapper", "--config", path))["map"]["l_max"] == 3.0


@pytest.mark.parametrize(
    "command", [["demo"], ["simulate"], ["replay", "nothing.jsonl"], ["build", "nothing", "--out", "x"]]
)
def test_every_command_with_settings_prints_them_and_does_nothing_else(command):
    assert yaml.safe_load(printed(*command, OGM_MAP__ALPHA="0.3"))["map"]["alpha"] == 0.3


def test_bad_settings_are_refused_all_the_same():
    assert printed("mapper", OGM_MAP__ALPHA="x", code=2) == ""


def test_secrets_are_masked_wherever_settings_are_shown():
    endpoint = "tls/h:7447#connect_certificate=c.pem;connect_private_key_base64=c2VjcmV0"
    text = printed("mapper", "--connect", f"{endpoint},tls/user:p/w@d@h:7447")
    assert "c2VjcmV0" not in text
    assert f"tls/{MASKED}@h:7447" in text
    assert "w@d" not in text
    assert f"connect_certificate=c.pem;connect_private_key_base64={MASKED}" in text
    settings = Settings.model_validate({"network": {"connect": [endpoint]}})
    assert "c2VjcmV0" not in " ".join(differences(settings))
    assert _plain(SecretStr("token")) == MASKED


def test_a_token_is_shown_nowhere_and_a_mask_is_none(tmp_path):
    token = "c2VjcmV0LXRva2VuLW9mLW91cnM"
    text = printed("mapper", OGM_HTTP__TOKEN=token)
    assert token not in text
    assert origins(text)["http.token"] == "environment OGM_HTTP__TOKEN"
    assert differences(Settings.model_validate({"http": {"token": token}})) == [f"http.token={MASKED}"]
    again = tmp_path / "again.yaml"
    again.write_text(text)
    with pytest.raises(BadSetting, match=r"http\.token"):
        load_settings(config=again, flags={}, environ={})


def test_differences_are_the_settings_that_are_not_the_defaults():
    assert differences(Settings()) == []
    values = {
        "map": {"resolution": 0.1, "alpha": 0.1, "bounds": [-1, -2, 3, 4]},
        "http": {"port": 0},
        "sensors": [{"match": "a/*", "deskew": False}],
    }
    assert differences(Settings.model_validate(values)) == [
        "map.resolution=0.1",
        "map.bounds=-1.0,-2.0,3.0,4.0",
        "http.port=0",
        "sensors=a/*",
    ]
