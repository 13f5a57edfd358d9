import math
import subprocess
import sys
from dataclasses import replace

import pytest
import yaml

from ogm_client.session import NetworkConfig
from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadSetting
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.wire.keys import DEFAULT_ADDRESS
from ogm_services.settings.settings import Settings
from ogm_services.settings.sources import load_settings, without_settings


@pytest.fixture
def load(tmp_path):
    """Load settings from the sources that are given; `file` is YAML text."""

    def load(*, file=None, env=None, flags=None):
        config = None
        if file is not None:
            config = tmp_path / "ogm.yaml"
            config.write_text(file)
        return load_settings(config=config, flags=flags or {}, environ=env or {})

    return load


def test_defaults_are_those_of_the_core(load):
    settings = load()
    assert settings.grid_settings() == GridSettings()
    assert settings.map.made_cell_model() == LogOdds()
    assert settings.map.preset is None
    assert settings.network.map_name == "default"
    assert (settings.http.host, settings.http.port) == ("127.0.0.1", 8000)
    limits = settings.mapper
    assert (limits.max_cells, limits.max_bytes) == (10**8, 2 * 1024**3)
    assert limits.max_memory == 3 * limits.max_bytes
    assert limits.max_scan_cells == 10**9
    assert (limits.max_beams, limits.pose_wait, limits.queue) == (200_000, 2.0, 4096)
    assert (limits.start_map, limits.start_confidence) == (None, 0.9)


LAB = GridSettings(
    resolution=0.1,
    cell_model=LogOdds("float64", p_prior=0.5, p_occ=0.7, p_free=0.3, l_min=-8.0, l_max=8.0),
    alpha=0.2,
    bounds=Region(-10.0, -10.0, 10.0, 10.0),
    outside="drop",
)


@pytest.mark.parametrize(
    "source",
    [
        {"file": "map: {preset: lab}"},
        {"env": {"OGM_MAP__PRESET": "lab"}},
        {"flags": {"map": {"preset": "lab"}}},
    ],
)
def test_a_preset_replaces_the_defaults_whichever_source_names_it(load, source):
    settings = load(**source)
    assert settings.grid_settings() == LAB
    assert (settings.map.sensor_model, settings.map.traversal) == ("beam", "bresenham")


def test_every_source_overrides_the_ones_before_it(load):
    file = "map: {preset: lab, p_occ: 0.8, p_free: 0.2, reach: 5}"
    env = {"OGM_MAP__P_FREE": "0.25", "OGM_MAP__REACH": "6"}
    flags = {"map": {"reach": "7"}}
    assert load().map.alpha == 0.1
    chosen = load(file=file, env=env, flags=flags).map
    assert chosen.p_prior == 0.5  # default and preset
    assert chosen.alpha == 0.2  # preset
    assert chosen.p_occ == 0.8  # file
    assert chosen.p_free == 0.25  # environment
    assert chosen.reach == 7.0  # flag


def test_a_preset_in_a_flag_does_not_override_the_file_or_the_environment(load):
    chosen = load(
        file="map: {alpha: 0.3}",
        env={"OGM_MAP__RESOLUTION": "0.2"},
        flags={"map": {"preset": "lab"}},
    ).map
    assert (chosen.alpha, chosen.resolution, chosen.cells) == (0.3, 0.2, "float64")


def test_a_higher_source_can_take_back_what_a_lower_one_set(load):
    chosen = load(file="map: {preset: lab, reach: 5}", flags={"map": {"preset": "none", "reach": "None"}}).map
    assert (chosen.preset, chosen.reach, chosen.bounds, chosen.resolution) == (None, None, None, 0.05)
    assert load(file="map: {preset: lab, bounds: null}").map.bounds is None


@pytest.mark.parametrize(
    ("env", "section", "key", "value"),
    [
        ({"OGM_MAP__BOUNDS": "-1, -2,3,4"}, "map", "bounds", Region(-1.0, -2.0, 3.0, 4.0)),
        ({"OGM_MAPPER__MAX_CELLS": "1e8"}, "mapper", "max_cells", 10**8),
        ({"OGM_MAPPER__QUEUE": "16"}, "mapper", "queue", 16),
        ({"OGM_NETWORK__LISTEN": "tcp/a:1, tcp/b:2"}, "network", "listen", ("tcp/a:1", "tcp/b:2")),
        ({"OGM_NETWORK__CONNECT": ""}, "network", "connect", ()),
        ({"OGM_HTTP__PORT": "0"}, "http", "port", 0),
        (
            {"OGM_HTTP__CORS_ORIGINS": "https://Map.Example, http://[::1]:3000,*"},
            *("http", "cors_origins", ("https://map.example", "http://[::1]:3000", "*")),
        ),
        ({"OGM_HTTP__HOSTS": "map.example, mapper"}, "http", "hosts", ("map.example", "mapper")),
        ({"OGM_MAP__CLEAR_RANGE": "0"}, "map", "clear_range", 0.0),
        ({"OGM_MAP__HALF_LIFE": "600"}, "map", "half_life", 600.0),
    ],
)
def test_text_is_read_as_what_the_setting_needs(load, env, section, key, value):
    found = getattr(getattr(load(env=env), section), key)
    assert found == value
    assert type(found) is type(value)


def test_a_file_holds_plain_yaml_values(load):
    file = "map: {bounds: [-1, -2, 3, 4]}\nmapper: {max_cells: 1e7}\nnetwork: {listen: [tcp/a:1]}\nhttp:\n"
    settings = load(file=file)
    assert settings.map.bounds == Region(-1.0, -2.0, 3.0, 4.0)
    assert settings.mapper.max_cells == 10**7
    assert settings.network.listen == ("tcp/a:1",)
    assert load(file="# nothing set\n") == Settings()


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"env": {"OGM_MAPPER__SEPARATE_ROBOTS": "on"}}, True),
        ({"env": {"OGM_MAPPER__SEPARATE_ROBOTS": "0"}}, False),
        ({"flags": {"mapper": {"separate_robots": True}}}, True),
        ({"file": "map: {cell_model: rate}\nmapper: {separate_robots: true}\n"}, True),
        ({"file": "map: {cell_model: rate}\nmapper: {separate_robots: false}\n"}, False),
    ],
)
def test_one_setting_is_a_switch(load, given, expected):
    flags = {"map": {"cell_model": "rate"}, **given.get("flags", {})}
    settings = load(**{**given, "flags": flags})
    assert settings.mapper.separate_robots is expected
    assert settings.grid_settings().separate_robots is expected


def test_a_switch_is_on_or_off(load):
    with pytest.raises(BadSetting, match=r"^mapper\.separate_robots: .*boolean.*'maybe'"):
        load(env={"OGM_MAPPER__SEPARATE_ROBOTS": "maybe"})


@pytest.mark.parametrize(
    ("source", "text"),
    [
        (
            {"env": {"OGM_MAP__RESOLUTON": "1"}},
            "environment OGM_MAP__RESOLUTON: unknown setting (did you mean OGM_MAP__RESOLUTION?)",
        ),
        (
            {"env": {"OGM_MAP_P_OCC": "0.8"}},
            "environment OGM_MAP_P_OCC: unknown setting (did you mean OGM_MAP__P_OCC?)",
        ),
        ({"env": {"OGM_MAPS__ALPHA": "1"}}, "environment OGM_MAPS__ALPHA: unknown setting"),
        ({"env": {"OGM_map__alpha": "1"}}, "environment OGM_map__alpha: unknown setting"),
        (
            {"file": "map: {modell: beam}"},
            "ogm.yaml: map.modell: unknown setting (did you mean map.cell_model?)",
        ),
        ({"file": "map: {alfa: 1}"}, "ogm.yaml: map.alfa: unknown setting (did you mean map.alpha?)"),
        ({"file": "htp: {port: 1}"}, "ogm.yaml: htp: unknown setting (did you mean http?)"),
        ({"file": "map: {1: 2}"}, "ogm.yaml: map.1: unknown setting"),
        ({"flags": {"map": {"reech": "1"}}}, "flag map.reech: unknown setting (did you mean map.reach?)"),
    ],
)
def test_unknown_names_are_refused_by_name(load, source, text):
    with pytest.raises(BadSetting) as caught:
        load(**source)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_names_of_another_form_are_none_of_our_business(load):
    assert load(env={"OGM_DATASETS": "/data", "MAP__ALPHA": "3", "HOME": "/root"}) == Settings()


@pytest.mark.parametrize(
    ("key", "value", "allowed"),
    [
        ("map.alpha", "-0.1", "greater than or equal to 0"),
        ("map.alpha", "inf", "finite"),
        ("map.alpha", "wide", "valid number"),
        ("map.reach", "0", "greater than 0"),
        ("map.reach", "nan", "finite"),
        ("map.clear_range", "-1", "greater than or equal to 0"),
        ("map.half_life", "0.9", "greater than or equal to 1"),
        ("map.half_life", "inf", "finite"),
        ("map.half_life", "1e300", "less than or equal to 1000000000"),
        ("map.resolution", "0.0009", "greater than or equal to 0.001"),
        ("map.p_occ", "1.5", "less than or equal to 1"),
        ("map.preset", "labs", "'lab'"),
        ("map.sensor_model", "sectr", "'beam'"),
        ("map.cells", "float32", "'int16' or 'float64'"),
        ("map.outside", "keep", "'clip' or 'drop'"),
        ("map.bounds", "1,2,3", "XMIN,YMIN,XMAX,YMAX"),
        ("map.bounds", "a,b,c,d", "XMIN,YMIN,XMAX,YMAX"),
        ("map.bounds", "0,0,1_0,1", "XMIN,YMIN,XMAX,YMAX"),
        ("http.port", "65536", "less than or equal to 65535"),
        ("http.port", "-1", "greater than or equal to 0"),
        ("http.hosts", "map.example:80", "names of hosts such as map.example.org are needed, without a port"),
        ("http.hosts", "*.example", "names of hosts"),
        ("http.root_path", "/", "a path such as /maps/hall, without a slash at its end, is needed"),
        ("http.root_path", "maps", "a path such as"),
        ("http.root_path", "/a/", "a path such as"),
        ("http.root_path", "//a", "a path such as"),
        ("http.root_path", "/a/..", "a path such as"),
        ("http.root_path", "/a?b", "a path such as"),
        ("http.forwarded_allow_ips", "*", "addresses and networks in digits are needed"),
        ("http.forwarded_allow_ips", "proxy.example", "addresses and networks"),
        ("http.forwarded_allow_ips", "10.0.0.1/8", "addresses and networks"),
        ("http.cors_origins", "map.example.org", "origins as browsers send them are needed"),
        ("http.cors_origins", "https://map.example.org/", "origins as browsers send them"),
        ("http.cors_origins", "https://map.example.org:443", "origins as browsers send them"),
        ("http.cors_origins", "https://*.example.org", "origins as browsers send them"),
        ("http.cors_origins", "null", "origins as browsers send them"),
        ("http.token_file", "/nowhere/token", "file"),
        ("mapper.max_beams", "0", "greater than or equal to 1"),
        ("mapper.max_scan_cells", "0", "greater than or equal to 1"),
        ("mapper.max_memory", "1000", "greater than or equal to 16777216"),
        ("mapper.max_cells", "1.5e0", "valid integer"),
        ("mapper.pose_wait", "-1", "greater than or equal to 0"),
        ("mapper.queue", "0", "greater than or equal to 1"),
        ("mapper.threads", "0", "a whole number from 1 to 64, or auto, is needed"),
        ("mapper.threads", "65", "a whole number from 1 to 64, or auto, is needed"),
        ("mapper.threads", "2.0", "a whole number from 1 to 64, or auto, is needed"),
        ("mapper.threads", "all", "a whole number from 1 to 64, or auto, is needed"),
        ("mapper.start_map", "/nowhere/map.yaml", "file"),
        ("mapper.start_confidence", "0.5", "greater than 0.5"),
        ("mapper.start_confidence", "1", "less than 1"),
        ("mapper.start_confidence", "nan", "finite"),
        ("network.listen", "localhost:7447", "an endpoint such as tcp/127.0.0.1:7447"),
        ("network.zenoh_config", "/nowhere/zenoh.json5", "file"),
    ],
)
def test_a_bad_value_is_refused_with_its_key_its_source_and_what_is_allowed(load, key, value, allowed):
    variable = "OGM_" + key.upper().replace(".", "__")
    with pytest.raises(BadSetting) as caught:
        load(env={variable: value})
    text = str(caught.value)
    assert text.startswith(f"{key}: ")
    assert text.endswith(f", got {value!r} (environment {variable})")
    assert allowed in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("source", "where"),
    [
        ({"file": "network: {map_name: 7}"}, "ogm.yaml)"),
        ({"flags": {"network": {"listen": "x"}}}, "(--listen)"),
        ({"flags": {"http": {"port": "x"}}}, "(--http-port)"),
        ({"flags": {"map": {"p_occ": "x"}}}, "(--p-occ)"),
        ({"flags": {"mapper": {"start_confidence": "x"}}}, "(--start-confidence)"),
        ({"file": "map: {preset: [lab]}"}, "ogm.yaml)"),
    ],
)
def test_a_bad_value_names_its_source(load, source, where):
    with pytest.raises(BadSetting, match="got") as caught:
        load(**source)
    assert str(caught.value).endswith(where)


def test_every_bad_value_is_named(load):
    with pytest.raises(BadSetting) as caught:
        load(env={"OGM_MAP__ALPHA": "-1"}, flags={"http": {"port": "70000"}})
    assert "map.alpha: " in str(caught.value)
    assert "http.port: " in str(caught.value)


@pytest.mark.parametrize("value", ["true", "no"])
def test_a_switch_is_no_number(load, value):
    with pytest.raises(BadSetting, match=r"map.reach: this is not a switch"):
        load(file=f"map: {{reach: {value}}}")


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"p_occ": "0.4"}, "p_free < p_prior < p_occ"),
        ({"l_min": "0.5"}, "l_min < logit(p_prior) < l_max"),
        ({"bounds": "0,0,1,0.98"}, "19.6 cells of 0.05 m in y"),
        ({"bounds": "1,0,0,1"}, "XMIN < XMAX"),
        ({"preset": "lab", "resolution": "0.3"}, "a whole number is needed"),
        ({"bounds": "0,0,10000,10000"}, "max_cells"),
        ({"p_occ": "0.50001"}, "float64"),
    ],
)
def test_contradictions_are_found_before_anything_starts(load, values, text):
    with pytest.raises(BadSetting) as caught:
        load(flags={"map": values})
    assert text in str(caught.value)


def test_limits_reach_the_grid_settings(load):
    grid = load(env={"OGM_MAPPER__MAX_CELLS": "5000", "OGM_MAPPER__MAX_BYTES": "1e6"}).grid_settings()
    assert (grid.max_cells, grid.max_bytes) == (5000, 10**6)


def test_a_map_name_must_fit_in_a_key(load):
    with pytest.raises(BadSetting, match="map_name 'a/b': a name is"):
        load(flags={"network": {"map_name": "a/b"}})


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"map: [", "not YAML"),
        (b"map: {resolution: 2001-13-45}", "not YAML"),
        (b"map: {resolution: !!int x}", "not YAML"),
        (b"[" * 3000, "not YAML"),
        (b"\xff\xfe\xff", "not YAML"),
        (b"map: {alpha: 0.1, alpha: 0.2}", "key 'alpha' is given twice"),
        (b"map: {alpha: 0.1}\nhttp: {port: 1}\nmap: {p_occ: 0.8}", "key 'map' is given twice"),
        (b"- map", "a mapping of names to values is needed"),
        (b"map: 3", "map: a mapping of names to values is needed, got 3"),
        (None, "cannot be read: No such file or directory"),
    ],
)
def test_a_file_that_is_no_settings_file_is_named(tmp_path, content, text):
    path = tmp_path / "ogm.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(BadSetting) as caught:
        load_settings(config=path, flags={}, environ={})
    assert str(caught.value).startswith(f"{path}: ")
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_settings_survive_their_own_yaml(load, tmp_path):
    zenoh_config = tmp_path / "zenoh.json5"
    zenoh_config.write_text("{}")
    settings = load(
        flags={
            "map": {"preset": "lab", "alpha": "1e-7", "p_occ": str(2 / 3), "reach": "12.5"},
            "network": {"listen": "tcp/a:1,tcp/b:2", "zenoh_config": str(zenoh_config), "map_name": "0x10"},
            "mapper": {"max_cells": "1e8"},
        }
    )
    assert load(file=settings.to_yaml()) == settings
    assert load(file=Settings().to_yaml()) == Settings()
    assert yaml.safe_load(settings.to_yaml())["map"]["p_occ"] == 2 / 3
    assert "resolution" not in yaml.safe_load(load(flags={"map": {"alpha": "0.2"}}).to_yaml())["map"]


def test_children_get_no_settings_from_the_environment():
    environ = {"OGM_MAP__ALPHA": "1", "OGM_MAP__TYPO": "1", "OGM_DATASETS": "/data", "PATH": "/bin"}
    assert without_settings(environ) == {"OGM_DATASETS": "/data", "PATH": "/bin"}


def test_on_its_own_a_mapper_listens_on_loopback_and_everyone_else_connects_to_it(load):
    network = load().network
    assert network.for_mapper() == NetworkConfig(listen=(DEFAULT_ADDRESS,), serves=True)
    assert network.for_client() == NetworkConfig(connect=(DEFAULT_ADDRESS,))


def test_a_service_that_is_told_where_to_go_goes_nowhere_else(load, tmp_path):
    zenoh_config = tmp_path / "zenoh.json5"
    zenoh_config.write_text("{}")
    told = {
        "listen": NetworkConfig(listen=("tcp/a:1",)),
        "connect": NetworkConfig(connect=("tcp/a:1",)),
        "zenoh_config": NetworkConfig(config_file=zenoh_config),
    }
    for key, config in told.items():
        value = str(zenoh_config) if key == "zenoh_config" else "tcp/a:1"
        network = load(flags={"network": {key: value}}).network
        assert network.for_client() == config
        assert network.for_mapper() == replace(config, serves=True)


def test_settings_do_not_change():
    with pytest.raises(ValueError, match="frozen"):
        Settings().map.alpha = math.inf


@pytest.mark.parametrize(
    ("source", "named"),
    [
        ({"flags": {"map": {"model": "sector"}}}, "--model"),
        ({"environ": {"OGM_MAP__MODEL": "sector"}}, "environment OGM_MAP__MODEL"),
        ({"config": "map: {model: sector}"}, "settings.yaml"),
    ],
    ids=["flag", "environment", "file"],
)
def test_the_sensor_models_old_name_holds_and_says_so(tmp_path, source, named):
    told = []
    given = {"config": None, "flags": {}, "environ": {}} | source
    if given["config"]:
        (tmp_path / "settings.yaml").write_text(given["config"])
        given["config"] = tmp_path / "settings.yaml"
    assert load_settings(**given, tell=told.append).map.sensor_model == "sector"
    (line,) = told
    assert named in line
    assert line.endswith("map.model is called map.sensor_model now (--sensor-model)")


def test_a_flag_by_its_old_name_overrides_the_file_by_the_new_one(tmp_path):
    file = tmp_path / "settings.yaml"
    file.write_text("map: {sensor_model: sector}")
    assert load_settings(config=file, flags={"map": {"model": "beam"}}, environ={}).map.sensor_model == "beam"


def test_both_names_at_once_are_refused():
    flags = {"map": {"model": "beam", "sensor_model": "sector"}}
    with pytest.raises(
        BadSetting, match=r"map\.model is map\.sensor_model now: give one of them \(--model\)"
    ):
        load_settings(config=None, flags=flags, environ={})


def test_no_settings_are_made_by_loading_what_reads_them():
    """Made while modules load, they would cost every command time, and miss the environment of later."""
    program = """
import gc
from pydantic import BaseModel
import ogm_services.cli
from ogm_services.settings import flags, settings, sources, values
assert issubclass(settings.Settings, BaseModel)
print([type(made).__name__ for made in gc.get_objects() if isinstance(made, BaseModel)])
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    assert ended.stdout == "[]\n"


TOKEN = "0123456789-._~+/=="


@pytest.mark.parametrize(
    "source", [{"env": {"OGM_HTTP__TOKEN": TOKEN}}, {"file": f"http: {{token: {TOKEN}}}"}]
)
def test_a_token_is_shown_nowhere_but_to_who_needs_it(load, source):
    settings = load(**source)
    assert settings.http.write_token() == TOKEN.encode()
    for text in (
        repr(settings),
        str(settings),
        settings.to_yaml(),
        settings.model_dump_json(),
        f"{settings.http}",
    ):
        assert "**********" in text
        assert TOKEN not in text
    assert load(file=settings.to_yaml(secrets=True)) == settings


@pytest.mark.parametrize(
    "token", ["", "short", "a" * 15, "a" * 513, "with a space in it", "ümlaute" * 3, "=" * 20]
)
def test_a_token_that_is_none_is_refused_and_not_shown(load, token):
    with pytest.raises(BadSetting) as caught:
        load(file=f"http: {{token: '{token}'}}")
    text = str(caught.value)
    assert text.startswith(
        "http.token: a token of 16 to 512 letters, digits and - . _ ~ + / is needed (file "
    )
    assert not token or token not in text


def test_a_number_is_no_token_and_is_not_shown(load):
    with pytest.raises(BadSetting) as caught:
        load(file="http: {token: 12345678901234567890}")
    assert "12345" not in str(caught.value)


def test_a_token_may_stand_in_a_file_of_its_own(load, tmp_path):
    file = tmp_path / "token"
    file.write_text(f" {TOKEN}\n")
    settings = load(env={"OGM_HTTP__TOKEN_FILE": str(file)})
    assert settings.http.write_token() == TOKEN.encode()
    file.write_text("two words, which are none")
    with pytest.raises(BadSetting, match=r"http\.token_file: .*token: a token of 16 to 512") as caught:
        settings.http.write_token()
    assert "words" not in str(caught.value)
    file.unlink()
    with pytest.raises(BadSetting, match="cannot be read: No such file"):
        settings.http.write_token()


def test_of_token_and_file_one_is_given(load, tmp_path):
    file = tmp_path / "token"
    file.write_text(TOKEN)
    with pytest.raises(BadSetting, match=r"http\.token, http\.token_file: give one of the two"):
        load(env={"OGM_HTTP__TOKEN": TOKEN, "OGM_HTTP__TOKEN_FILE": str(file)})
    assert load(env={}).http.write_token() is None


@pytest.mark.parametrize("host", ["127.0.0.1:8000", "http://127.0.0.1", "", " ", "[::1]:8000"])
def test_the_address_of_http_has_no_port(host):
    with pytest.raises(BadSetting, match=r"http\.host: an address without a port .*--http-port") as error:
        load_settings(config=None, flags={}, environ={"OGM_HTTP__HOST": host})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "fe80::1%eth0", "localhost", "robot-1.example.org"])
def test_an_address_or_a_name_is_what_http_is_served_on(host):
    assert load_settings(config=None, flags={}, environ={"OGM_HTTP__HOST": host}).http.host == host


@pytest.mark.parametrize("name", ["traversal", "cells", "p_prior", "p_occ", "p_free", "l_min", "l_max"])
def test_a_model_that_counts_takes_nothing_of_log_odds(load, name):
    value = str(getattr(Settings().map, name))
    with pytest.raises(BadSetting, match=rf"^map\.{name}: cell model rate counts and has no log odds"):
        load(flags={"map": {"cell_model": "rate", name: value}})
    with pytest.raises(BadSetting, match=r"^map\.p_occ, map\.l_max: cell model rate"):
        load(flags={"map": {"cell_model": "rate", "l_max": "4", "p_occ": "0.8"}})


def test_a_model_that_counts_is_chosen_by_name(load):
    settings = load(flags={"map": {"cell_model": "rate", "sensor_model": "beam", "reach": "20"}})
    assert settings.grid_settings().cell_model == Rate()
    with pytest.raises(BadSetting, match="sensor_model: cell model rate takes beam, not sector"):
        load(flags={"map": {"cell_model": "rate", "sensor_model": "sector"}})
    with pytest.raises(BadSetting, match=r"resolution: 0\.002 m or more is needed"):
        load(flags={"map": {"cell_model": "rate", "resolution": "0.001"}})


def test_a_preset_says_nothing_of_log_odds_to_a_model_that_counts(load):
    lab = load(flags={"map": {"preset": "lab", "cell_model": "rate"}}).grid_settings()
    assert (lab.cell_model, lab.resolution, lab.outside) == (Rate(), 0.1, "drop")
