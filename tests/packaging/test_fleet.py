"""deploy/ and docker/compose.shares.yaml: what they start takes its settings, and keeps one whole map.

Shares, a router and two gateways as processes are in tests/e2e/test_gateways.py.
"""

import json
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml
import zenoh

from fleet_files import KUBERNETES, containers, environment, one, resources, settings_of, unit_keys
from ogm_services.cli import app
from ogm_services.mapper.live.first_warm_up import COMPILATION
from ogm_services.mapper.live.watch import LOOK_PERIOD
from ogm_services.mapper.service import STOP_TIME
from ogm_services.runtime.endings import BAD_INPUT
from ogm_services.settings.sources import load_settings

ROOT = Path(__file__).parents[2]
UNITS = ROOT / "deploy/systemd"
COMPOSE = yaml.safe_load((ROOT / "docker/compose.shares.yaml").read_text())["services"]
ALONE = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())["services"]
PODS = [("StatefulSet", "share"), ("Deployment", "gateway")]
PYTHON_ALONE = 300 << 20
"""What Python and its libraries take beside `max_memory`, bytes: docs/operate.md."""


def taken(words):
    """The command's name, and what `ogm` makes of its flags."""
    name, *flags = words
    return name, typer.main.get_command(app).commands[name].make_context(name, list(flags)).params


def validate(*files):
    words = [sys.executable, "-m", "kubernetes_validate", "--strict", "--quiet", *files]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def test_kubernetes_takes_every_resource(tmp_path):
    files = [path for path in KUBERNETES.glob("*.yaml") if path.name != "kustomization.yaml"]
    listed = yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text())["resources"]
    assert {path.name for path in files} == set(listed)
    for version in ([], ["-k", "1.28"]):
        ended = validate(*version, *files)
        assert ended.returncode == 0, ended.stdout + ended.stderr
    wrong = tmp_path / "shares.yaml"
    wrong.write_text((KUBERNETES / "shares.yaml").read_text().replace("podManagementPolicy", "podManagment"))
    assert validate(wrong).returncode == 1  # else nothing was looked at


def test_kustomize_gives_every_resource_the_namespace_and_the_image(tmp_path):
    if shutil.which("kubectl") is None:
        pytest.skip("kubectl is not installed")
    words = ["kubectl", "kustomize", KUBERNETES]
    made = subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout
    found = [part for part in yaml.safe_load_all(made) if part]
    assert len(found) == len(resources())
    assert {part["metadata"]["namespace"] for part in found} == {"zenoh-ogm"}
    version = re.search(r'(?m)^version = "(.+)"', (ROOT / "pyproject.toml").read_text())[1]
    images = {container["image"] for part in found for container in containers(part)}
    assert images == {f"zenoh-ogm:{version}", ALONE["router"]["image"]}


def test_there_are_as_many_pods_as_shares_and_each_keeps_its_own(tmp_path):
    share = one("StatefulSet", "share")["spec"]
    settings = [settings_of("StatefulSet", "share", tmp_path, str(k)) for k in range(share["replicas"])]
    kept = [each.shares.of_mapper() for each in settings]
    assert [each.index for each in kept] == list(range(kept[0].cuts.count))
    kept[0].cuts.check(settings[0].grid_settings().lattice, settings[0].map.bounds)
    assert settings[0].map.reach is not None
    gateway = settings_of("Deployment", "gateway", tmp_path)
    assert (gateway.shares.cuts, gateway.map) == (kept[0].cuts, settings[0].map)
    (indexed,) = [each for each in containers(one("StatefulSet", "share"))[0]["env"] if "valueFrom" in each]
    label = "metadata.labels['apps.kubernetes.io/pod-index']"
    assert indexed == {"name": "OGM_SHARES__INDEX", "valueFrom": {"fieldRef": {"fieldPath": label}}}


@pytest.mark.parametrize(("kind", "name"), PODS)
def test_pods_run_a_command_of_the_image_with_what_they_may_write(kind, name, dockerfile):
    spec = one(kind, name)["spec"]
    pod = spec["template"]["spec"]
    (container,) = pod["containers"]
    command, flags = taken(container["args"])
    assert command == ("mapper" if name == "share" else "gateway")
    mounts = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
    assert str(Path(flags["config"]).parent) in mounts
    (user,) = (found.text for found in dockerfile[-1] if found.name == "USER")
    context = pod["securityContext"]
    assert f"{context['runAsUser']}:{context['runAsGroup']}" == user
    assert context["fsGroup"] == context["runAsGroup"]
    assert container["securityContext"]["readOnlyRootFilesystem"] is True
    (written,) = (found.words for found in dockerfile[-1] if found.name == "VOLUME")
    assert {*mounts} - {"/etc/ogm"} == {"/tmp", *written[: 2 if name == "share" else 1]}
    claims = [claim["metadata"]["name"] for claim in spec.get("volumeClaimTemplates", ())]
    assert {*mounts.values()} == {*claims, *(volume["name"] for volume in pod["volumes"])}
    if name == "share":
        assert environment(container)["OGM_MAPPER__DATA"].startswith("/var/lib/ogm/")
        assert claims == [mounts["/var/lib/ogm"]]
        assert spec["volumeClaimTemplates"][0]["spec"]["accessModes"] == ["ReadWriteOncePod"]
    (copied,) = pod["initContainers"]
    assert copied["command"] == ["cp", "-r", f"{written[0]}/.", "/kernels"]
    assert copied["volumeMounts"] == [{"name": mounts[written[0]], "mountPath": "/kernels"}]


@pytest.mark.parametrize(("kind", "name"), PODS)
def test_probes_and_limits_fit_what_is_probed(kind, name, tmp_path):
    pod = one(kind, name)["spec"]["template"]["spec"]
    (container,) = pod["containers"]
    settings = settings_of(kind, name, tmp_path, "0")
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert ports == {"http": settings.http.port}
    probes = {probe: container[probe] for probe in ("startupProbe", "livenessProbe", "readinessProbe")}
    paths = {probe: value["httpGet"]["path"] for probe, value in probes.items()}
    assert paths == {"startupProbe": "/livez", "livenessProbe": "/livez", "readinessProbe": "/readyz"}
    assert {value["httpGet"]["port"] for value in probes.values()} == {"http"}
    start = probes["startupProbe"]
    assert start["periodSeconds"] * start["failureThreshold"] == 120
    assert pod["terminationGracePeriodSeconds"] > 2 * STOP_TIME
    assert container["resources"]["limits"]["memory"] == "4Gi"
    assert settings.mapper.max_memory + PYTHON_ALONE < 4 << 30
    assert settings.mapper.max_bytes < settings.mapper.max_memory


def test_services_lead_to_pods_and_settings_name_the_services(tmp_path):
    pods = [each for each in resources() if each["kind"] in ("Deployment", "StatefulSet")]
    for service in (each for each in resources() if each["kind"] == "Service"):
        chosen = service["spec"]["selector"]
        (pod,) = [each for each in pods if each["spec"]["template"]["metadata"]["labels"] == chosen]
        names = {port["name"]: port["containerPort"] for port in containers(pod)[0]["ports"]}
        for port in service["spec"]["ports"]:
            assert names[port["targetPort"]] == port["port"]
        assert pod["spec"]["selector"]["matchLabels"] == chosen
    share = one("StatefulSet", "share")["spec"]
    assert one("Service", share["serviceName"])["spec"]["clusterIP"] == "None"
    (budget,) = [each["spec"] for each in resources() if each["kind"] == "PodDisruptionBudget"]
    assert budget == {"maxUnavailable": 1, "selector": share["selector"]}
    settings = settings_of("StatefulSet", "share", tmp_path, "0")
    router = one("Service", "router")
    assert settings.network.connect == (f"tcp/router:{router['spec']['ports'][0]['port']}",)
    assert settings.network.listen == ()
    assert one("Service", "gateway")["metadata"]["name"] in settings.http.hosts


def test_the_router_is_the_one_of_docker(tmp_path):
    (container,) = containers(one("Deployment", "router"))
    assert container["image"] == ALONE["router"]["image"] == COMPOSE["router"]["image"]
    assert container["args"] == ALONE["router"]["command"]
    path = tmp_path / "router.json5"
    path.write_text(one("ConfigMap", "settings")["data"]["router.json5"])
    mine, theirs = (zenoh.Config.from_file(str(each)) for each in (path, ROOT / "docker/zenoh/router.json5"))
    for key in ("mode", "listen", "scouting", "connect", "transport/link/tx/lease"):
        assert json.loads(mine.get_json(key)) == json.loads(theirs.get_json(key))
    assert one("Deployment", "router")["spec"]["strategy"] == {"type": "Recreate"}
    assert COMPOSE["router"] == ALONE["router"]


@pytest.mark.parametrize("name", ["ogm-mapper@.service", "ogm-gateway.service"])
def test_systemd_finds_no_fault(tmp_path, name):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed")
    assert faults(tmp_path, name, (UNITS / name).read_text()) == ""
    misplaced = (UNITS / name).read_text().replace("[Service]", "[Service]\nStartLimitBurst=3x\nNoSuchKey=1")
    assert "NoSuchKey" in faults(tmp_path, name, misplaced)


def faults(folder, name, text):
    """What systemd-analyze says of a unit: it ends with 0 in spite of most faults, but prints them."""
    (folder / name).write_text(text.replace("/opt/ogm/bin/ogm", sys.executable))
    words = ["systemd-analyze", "verify", folder / name]
    ended = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    said = (ended.stdout + ended.stderr).splitlines()
    return "\n".join(line for line in said if name.partition("@")[0].partition(".")[0] in line)


def test_units_start_a_share_and_a_gateway_of_the_map_that_the_file_cuts(tmp_path):
    config = UNITS / "settings.yaml"
    for name in ("ogm-mapper@.service", "ogm-gateway.service"):
        (command,) = unit_keys(UNITS / name)["ExecStart"]
        program, *words = shlex.split(command.replace("%i", "2"))
        assert Path(program).name == "ogm"
        started, flags = taken(words)
        assert Path(flags["config"]) == Path("/etc/ogm/settings.yaml")
        lines = unit_keys(UNITS / name)["Environment"]
        environ = dict(word.split("=", 1) for line in lines for word in shlex.split(line))
        given = {"shares": {"index": flags["index"]}} if started == "mapper" else {}
        settings = load_settings(config=config, flags=given, environ=environ)
        settings.shares.cuts.check(settings.grid_settings().lattice, settings.map.bounds)
        assert settings.shares.cuts.count == 4
        assert settings.network.listen == ()
        if started == "mapper":
            assert settings.shares.of_mapper().index == 2
            assert settings.map.reach is not None


@pytest.mark.parametrize("name", ["ogm-mapper@.service", "ogm-gateway.service"])
def test_units_have_as_few_rights_and_as_much_time_as_the_one_mappers(name):
    mine, alone = unit_keys(UNITS / name), unit_keys(ROOT / "docker/ogm-mapper.service")
    own = {"ExecStart", "Environment", "CacheDirectory", "StateDirectory", "StateDirectoryMode"}
    assert {key: value for key, value in mine.items() if key not in own} == {
        key: value for key, value in alone.items() if key not in own
    }
    assert mine["RestartPreventExitStatus"] == [str(BAD_INPUT)]
    assert int(mine["WatchdogSec"][0]) > 10 * LOOK_PERIOD + STOP_TIME
    assert int(mine["TimeoutStartSec"][0]) > 10 * max(COMPILATION.values())
    words = " ".join(mine["Environment"])
    (cache,) = mine["CacheDirectory"]
    assert f"NUMBA_CACHE_DIR=%C/{cache}" in words
    if "@" in name:
        (state,) = mine["StateDirectory"]
        assert f"OGM_MAPPER__DATA=%S/{state}" in words
        assert state.endswith("-%i")  # each instance has a user of its own
        assert cache.endswith("-%i")


def test_containers_are_all_shares_of_one_map_and_gateways_of_it():
    shares, gateways, stores = [], [], set()
    for name, service in COMPOSE.items():
        if name == "router":
            continue
        command, flags = taken(service["command"])
        assert flags["connect"] == ALONE["mapper"]["command"][2]
        settings = load_settings(config=None, flags={}, environ=service["environment"])
        settings.shares.cuts.check(settings.grid_settings().lattice, settings.map.bounds)
        (shares if command == "mapper" else gateways).append(settings)
        stores |= {mount for mount in service["volumes"] if mount.endswith(":/var/lib/ogm")}
        same = ("read_only", "tmpfs", "cap_drop", "image", "security_opt", "restart", "build", "init")
        assert {key: service[key] for key in same} == {key: ALONE["mapper"][key] for key in same}
    assert [each.shares.of_mapper().index for each in shares] == list(range(shares[0].shares.cuts.count))
    assert len(stores) == len(shares)
    assert len(gateways) == 2
    assert len({(each.shares.cuts, each.map.reach) for each in (*shares, *gateways)}) == 1
    assert [port for each in COMPOSE.values() for port in each.get("ports", ())] == [
        "127.0.0.1:7447:7447",
        "127.0.0.1:8000:8000",
        "127.0.0.1:8001:8000",
    ]
