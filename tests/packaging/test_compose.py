"""docker/compose.yaml: its services, run as processes, find each other through its router and make a map."""

import http.client
import json
import os
import re
import sys
from pathlib import Path

import pytest
import typer
import yaml
import zenoh

from ogm_client.session import resolve_listen
from ogm_services.cli import app
from ogm_services.settings.sources import without_settings

DOCKER = Path(__file__).parents[2] / "docker"
COMPOSE = yaml.safe_load((DOCKER / "compose.yaml").read_text())
SERVICES = COMPOSE["services"]
OURS = ("mapper", "simulator")
ROUTER = "tcp/router:7447"
STARTED = 120.0


@pytest.fixture
def router_config(tmp_path, endpoint):
    """The router's configuration, as the router finds it in its container, but for the address."""
    source, target, mode = SERVICES["router"]["volumes"][0].split(":")
    assert SERVICES["router"]["command"] == ["--config", target]
    assert mode == "ro"
    text = (DOCKER / source).read_text()
    assert text.count('"tcp/0.0.0.0:7447"') == 1
    path = tmp_path / Path(target).name
    path.write_text(text.replace("tcp/0.0.0.0:7447", endpoint))
    return path


@pytest.fixture
def router(router_config, endpoint):
    """A router of that configuration; its endpoint."""
    with zenoh.open(zenoh.Config.from_file(router_config)):
        yield endpoint


def command(service, endpoint, *flags):
    """A service's command as a process of this machine; the last of two equal flags counts."""
    words = SERVICES[service]["command"]
    assert ROUTER in words
    words = [endpoint if word == ROUTER else word for word in words]
    return [sys.executable, "-m", "ogm_services", *words, *flags]


def get(port, path):
    """Status and body of a route; status None while nobody listens."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.read()
    except ConnectionRefusedError:
        return None, b""
    finally:
        connection.close()


def test_scans_arrive_in_the_map_through_the_router(router, services, eventually):
    environ = without_settings(os.environ)
    port = resolve_listen("tcp/127.0.0.1:0").rpartition(":")[2]
    mine = ("--http-host", "127.0.0.1", "--http-port", port)
    services("mapper", command("mapper", router, *mine), env=environ)
    eventually(lambda: get(port, "/readyz")[0] == 200, STARTED)
    assert json.loads(get(port, "/status")[1])["revision"] == 0
    services("simulator", command("simulator", router), env=environ)
    eventually(lambda: json.loads(get(port, "/status")[1])["scans"]["integrated"] > 20, STARTED)
    status = json.loads(get(port, "/status")[1])
    assert list(status["robots"]) == ["robot1"]
    assert sum(status["scans"]["dropped"].values()) == 0
    assert get(port, "/map.png")[1].startswith(b"\x89PNG")


def test_the_router_listens_where_the_others_connect_and_looks_for_nobody(router_config, endpoint):
    config = zenoh.Config.from_file(router_config)
    assert json.loads(config.get_json("mode")) == "router"
    assert json.loads(config.get_json("listen/endpoints")) == [endpoint]
    for way in ("multicast", "gossip"):
        assert json.loads(config.get_json(f"scouting/{way}/enabled")) is False
    assert json.loads(config.get_json("connect/endpoints")) == []


def test_the_router_is_of_the_zenoh_that_the_project_needs():
    needed = re.search(r'"eclipse-zenoh>=(\d+)\.(\d+)"', (DOCKER.parent / "pyproject.toml").read_text())
    name, *version = re.fullmatch(r"([a-z/]+):(\d+)\.(\d+)\.\d+", SERVICES["router"]["image"]).groups()
    assert name == "eclipse/zenoh"
    assert version[0] == needed[1]
    assert int(version[1]) >= int(needed[2])


@pytest.mark.parametrize("service", OURS)
def test_commands_are_ones_that_ogm_takes(service):
    name, *flags = SERVICES[service]["command"]
    context = typer.main.get_command(app).commands[name].make_context(name, list(flags))
    assert context.params["connect"] == ROUTER


@pytest.mark.parametrize("service", OURS)
def test_our_services_run_the_image_with_as_little_as_it_needs(service, dockerfile):
    mine = SERVICES[service]
    build = mine["build"]
    assert (DOCKER / build["context"]).resolve() == DOCKER.parent
    assert (DOCKER / build["context"] / build["dockerfile"]).samefile(DOCKER / "Dockerfile")
    assert mine["read_only"] is True
    assert mine["tmpfs"] == ["/tmp"]
    assert mine["cap_drop"] == ["ALL"]
    assert "cap_add" not in mine
    assert mine["security_opt"] == ["no-new-privileges:true"]
    assert mine["restart"] == "unless-stopped"
    assert mine["image"] == SERVICES["mapper"]["image"]
    (volumes,) = (found.words for found in dockerfile[-1] if found.name == "VOLUME")
    for mount in mine.get("volumes", ()):
        name, target = mount.split(":")
        assert name in COMPOSE["volumes"]
        assert target in volumes


def test_the_mapper_serves_where_the_image_says(dockerfile):
    (environ,) = (found.words for found in dockerfile[-1] if found.name == "ENV")
    assert "OGM_HTTP__HOST=0.0.0.0" in environ
    assert not [name for name in SERVICES["mapper"]["environment"] if name.startswith("OGM_HTTP")]
    assert not [word for word in SERVICES["mapper"]["command"] if word.startswith("--http")]


def test_the_mapper_stores_its_map_in_a_volume():
    folder = SERVICES["mapper"]["environment"]["OGM_MAPPER__DATA"]
    assert folder in [mount.split(":")[1] for mount in SERVICES["mapper"]["volumes"]]


def test_ports_are_the_images_and_open_on_this_machine_only(dockerfile):
    (exposed,) = (set(found.words) for found in dockerfile[-1] if found.name == "EXPOSE")
    published = {}
    for name, service in SERVICES.items():
        for port in service.get("ports", ()):
            host, outside, inside = port.split(":")
            assert (host, outside) == ("127.0.0.1", inside)
            published[name] = inside
    assert published == {"router": "7447", "mapper": "8000"}
    assert set(published.values()) == exposed


def test_the_simulator_waits_for_a_mapper_that_the_image_calls_healthy(dockerfile):
    (check,) = (found for found in dockerfile[-1] if found.name == "HEALTHCHECK")
    assert SERVICES["mapper"]["healthcheck"]["test"] == [
        "CMD",
        *json.loads(check.text.removeprefix("CMD ")),
    ]
    assert SERVICES["mapper"]["depends_on"] == {"router": {"condition": "service_started"}}
    assert SERVICES["simulator"]["depends_on"] == {"mapper": {"condition": "service_healthy"}}
    assert SERVICES["simulator"]["healthcheck"] == {"disable": True}
