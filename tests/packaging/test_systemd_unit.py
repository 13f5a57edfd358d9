"""docker/ogm-mapper.service: systemd reads it, and ogm takes what it says."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from fleet_files import unit_keys
from ogm_services.cli import app
from ogm_services.mapper.live.first_warm_up import COMPILATION
from ogm_services.mapper.live.watch import LOOK_PERIOD
from ogm_services.mapper.service import STOP_TIME
from ogm_services.runtime.endings import BAD_INPUT
from ogm_services.settings.sources import load_settings

UNIT = Path(__file__).parents[2] / "docker/ogm-mapper.service"
ON = ("DynamicUser", "ProtectHome", "PrivateTmp", "PrivateDevices", "NoNewPrivileges", "RestrictNamespaces")


@pytest.fixture(scope="module")
def service():
    """Values of every key of the section [Service], in order."""
    return unit_keys(UNIT)


@pytest.fixture(scope="module")
def environ(service):
    return dict(word.split("=", 1) for line in service["Environment"] for word in shlex.split(line))


def test_ogm_takes_the_command_and_the_settings(service, environ):
    ((program, name, *flags),) = map(shlex.split, service["ExecStart"])
    assert Path(program).name == "ogm"
    typer.main.get_command(app).commands[name].make_context(name, flags)
    settings = load_settings(config=None, flags={}, environ=environ)
    assert settings.network.listen == ("tcp/127.0.0.1:7447",)
    assert (settings.http.host, settings.http.port) == ("127.0.0.1", 8000)


def test_kernels_go_to_the_one_folder_that_may_be_written(service, environ):
    (cache,) = service["CacheDirectory"]
    assert environ["NUMBA_CACHE_DIR"] == f"%C/{cache}"
    assert service["ProtectSystem"] == ["strict"]
    assert [service[key] for key in ON] == [["yes"]] * len(ON)
    assert service["CapabilityBoundingSet"] == [""]
    assert "MemoryDenyWriteExecute" not in service


def test_the_map_is_stored_in_the_folder_that_systemd_keeps(service, environ):
    (state,) = service["StateDirectory"]
    assert environ["OGM_MAPPER__DATA"] == f"%S/{state}"


def test_it_starts_again_after_a_failure_but_not_with_bad_settings(service):
    assert service["Restart"] == ["on-failure"]
    assert service["RestartPreventExitStatus"] == [str(BAD_INPUT)]


def test_it_is_started_once_it_says_that_it_is_ready_and_is_given_time_for_that_and_to_stop(service):
    assert service["Type"] == ["notify"]  # READY=1: test_service_manager.py
    assert "NotifyAccess" not in service  # it is the mapper itself that says so
    assert "AF_UNIX" in service["RestrictAddressFamilies"][0].split()
    assert int(service["TimeoutStartSec"][0]) > 10 * max(COMPILATION.values())
    assert int(service["TimeoutStopSec"][0]) > 2 * STOP_TIME
    assert int(service["WatchdogSec"][0]) > 10 * LOOK_PERIOD + STOP_TIME


def test_systemd_finds_no_fault(tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    copy = tmp_path / UNIT.name
    copy.write_text(UNIT.read_text().replace("/opt/ogm/bin/ogm", sys.executable))
    ended = subprocess.run(["systemd-analyze", "verify", copy], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert UNIT.name not in ended.stderr, ended.stderr  # what it says of this system's own units is not ours


def test_the_token_that_it_shows_comes_from_systemd_and_is_taken(tmp_path, environ):
    shown = re.findall(r"(?m)^#(LoadCredential|Environment)=(\S+)", UNIT.read_text())
    (credential, (_, setting)) = shown
    name, _, _ = credential[1].partition(":")
    (tmp_path / name).write_text("0f" * 24 + "\n")
    key, _, value = setting.partition("=")
    environ = {**environ, key: value.replace("%d", str(tmp_path))}
    settings = load_settings(config=None, flags={}, environ=environ)
    assert str(tmp_path / name) == str(settings.http.token_file)
