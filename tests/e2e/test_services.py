"""The services by hand, each a process of its own: started, asked, killed, restarted, stopped."""

import json
import signal
import socket
import time
from contextlib import ExitStack
from urllib.parse import urlsplit

import numpy as np
import pytest
import yaml
from PIL import Image

STOPS = [signal.SIGTERM, signal.SIGINT]


@pytest.fixture
def mapper(ogm):
    return ogm.ready(ogm.mapper())


def simulator(ogm, mapper, *flags):
    return ogm.start("simulate", "--connect", mapper.endpoint, *flags)


def source(mapper):
    """What the status says of the simulated robot's LiDAR; None before its first scan."""
    return mapper.status()["robots"].get("robot1", {"sources": {}})["sources"].get("laser")


def test_by_hand(ogm, mapper, eventually):
    ended = simulator(ogm, mapper, "--scans", 20, "--robots", 2).wait()
    assert (ended.code, ended.err) == (0, "")
    assert ended.out == "robot1, robot2 in lab: 20 scans a second each, at up to 3.43 m/s\n"
    eventually(lambda: mapper.status()["revision"] == 40)
    asked = [
        ask("status", "--json", "--url", url)
        for ask, url in ((ogm.run, mapper.url), (ogm.call, mapper.endpoint))
    ]
    table = ogm.call("status", "--url", mapper.endpoint)
    expected = mapper.status()
    # The known cells may be of a moment ago, and so of different moments.
    known = expected["map_info"].pop("known_cells")
    ages = {name: robot.pop("age_s") for name, robot in expected["robots"].items()}
    for ended in asked:
        assert ended.code == 0
        found = json.loads(ended.out)
        assert found["map_info"].pop("known_cells") == pytest.approx(known, rel=0.5)
        assert all(robot.pop("age_s") <= ages[name] for name, robot in found["robots"].items())
        assert found == {**expected, "uptime_s": pytest.approx(expected["uptime_s"], abs=10)}
    assert expected["robots"].keys() == {"robot1", "robot2"}
    assert "40 received, 40 integrated, 0 pending" in table.out


def test_get(ogm, mapper, lab_recording, assert_equal_maps):
    assert ogm.call("replay", lab_recording, "--speed", "max", "--connect", mapper.endpoint).code == 0
    wanted = [
        ("map.png", "map.png", mapper.endpoint),
        ("map.npz", "map.npz", mapper.url),
        ("map.json?region=-1,-1,1,1", "map.json", mapper.endpoint),
        ("map.yaml", "X.yaml", mapper.endpoint),
        ("map.yaml", "Y.yaml", mapper.url),
    ]
    runs = [ogm.run, *[ogm.call] * (len(wanted) - 1)]
    getting = [
        run("get", name, "-o", out, "--url", url) for run, (name, out, url) in zip(runs, wanted, strict=True)
    ]
    printed = ogm.run("get", "status", "-o", "-", "--url", mapper.url)
    refused = ogm.call("get", "map.png?region=1,1,0,0", "-o", "no.png", "--url", mapper.endpoint)
    for ended in getting:
        assert (ended.code, ended.out, ended.err) == (0, "", "")
    assert (ogm.folder / "map.png").read_bytes() == mapper.get("map.png")
    assert (ogm.folder / "map.json").read_bytes() == mapper.get("map.json?region=-1,-1,1,1")
    assert_equal_maps(ogm.map("map.npz"), mapper.map())
    for name in "XY":
        fields = yaml.safe_load((ogm.folder / f"{name}.yaml").read_text())
        assert fields["image"] == f"{name}.pgm"
        assert fields["origin"][:2] == mapper.map()["origin"].tolist()
        with Image.open(ogm.folder / f"{name}.pgm") as pgm, Image.open(ogm.folder / "map.png") as png:
            assert np.array_equal(np.asarray(pgm), np.asarray(png))
    assert json.loads(printed.out)["revision"] == 220
    assert "region" in refused.complaint(2)
    assert not (ogm.folder / "no.png").exists()


def test_a_killed_simulator_starts_again_and_is_mapped(ogm, mapper, eventually):
    first = simulator(ogm, mapper)
    eventually(lambda: mapper.status()["revision"] > 10)
    first.stop(signal.SIGKILL)
    before = eventually(lambda: (book := source(mapper))["pending"] == 0 and book)
    second = simulator(ogm, mapper)
    after = eventually(
        lambda: (book := source(mapper))["run"] != before["run"] and book["last_seq"] > 10 and book
    )
    assert second.stop().code == 0
    assert after["run"]
    assert after["integrated"] - before["integrated"] > 10
    status = mapper.status()
    assert status["revision"] >= after["integrated"]
    assert sum(status["scans"]["dropped"].values()) == status["poses"]["late"] == 0


def test_a_simulator_outlives_its_mapper(ogm, mapper, eventually):
    robot = simulator(ogm, mapper)
    eventually(lambda: mapper.status()["revision"] > 3)
    mapper.command.stop(signal.SIGKILL)
    again = ogm.ready(ogm.start("mapper", "--http-port", "0", "--listen", mapper.endpoint))
    eventually(lambda: again.status()["revision"] > 3)
    ended = robot.stop()
    assert (ended.code, ended.err) == (0, "")


@pytest.mark.parametrize("number", STOPS)
def test_services_stop_while_scans_stream_and_clients_hang_on(ogm, mapper, eventually, number):
    robot = simulator(ogm, mapper, "--rate", "100", "--robots", "3")
    eventually(lambda: mapper.status()["revision"] > 50)
    address = urlsplit(mapper.url)
    with ExitStack() as open_sockets:
        clients = [
            open_sockets.enter_context(socket.create_connection((address.hostname, address.port)))
            for _ in range(4)
        ]
        idle, asking, half, _silent = clients
        for client in (idle, asking):
            client.sendall(b"GET /status HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert idle.recv(100).startswith(b"HTTP/1.1 200 OK")  # and keeps the connection
        asking.sendall(b"GET /map.json HTTP/1.1\r\nHost: localhost\r\n\r\n" * 40)  # and never reads on
        half.sendall(b"POST /reset HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\n")
        ended = mapper.command.stop(number)
        assert ended.code == 0, ended
    ended = robot.stop(number)
    said = [line for line in ended.err.splitlines() if not line.endswith("too slowly")]  # on a busy machine
    assert (ended.code, said) == (0, [])


@pytest.mark.parametrize("number", STOPS)
def test_more_signals_change_nothing(ogm, mapper, eventually, number):
    robot = simulator(ogm, mapper)
    eventually(lambda: mapper.status()["revision"] > 3)
    for service in (robot, mapper.command):
        while service.process.poll() is None:
            service.process.send_signal(number)
            time.sleep(0.02)
        assert (service.wait().code, service.wait().warnings) == (0, "")


def test_two_mappers_of_one_map_or_port_are_one_too_many(ogm, idle_mapper):
    http_port = urlsplit(idle_mapper.url).port
    starting = {
        f"--http-port {http_port}: ": ogm.start(
            "mapper", "--http-port", http_port, "--listen", "tcp/127.0.0.1:0"
        ),
        f"cannot listen on {idle_mapper.endpoint}: ": ogm.start(
            "mapper", "--http-port", 0, "--listen", idle_mapper.endpoint
        ),
        "another mapper of map 'default' is alive": ogm.start(
            "mapper", "--http-port", 0, "--connect", idle_mapper.endpoint, "--out", "out"
        ),
    }
    for text, command in starting.items():
        assert text in command.wait().complaint(1)
    assert list((ogm.folder / "out").iterdir()) == []  # looked at, and nothing written
    hall = ogm.ready(
        ogm.start("mapper", "--http-port", 0, "--connect", idle_mapper.endpoint, "--map", "hall")
    )
    assert (hall.status()["map"], idle_mapper.status()["map"]) == ("hall", "default")


def test_without_a_mapper_every_command_says_what_to_check(ogm, endpoint):
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{unused.getsockname()[1]}"
        commands = {
            ogm.call("get", "map.png", "-o", "map.png", "--url", endpoint): endpoint,
            ogm.call("get", "map.png", "-o", "map.png", "--url", url): url,
            ogm.run("status", "--url", endpoint): endpoint,
            ogm.call("status", "--url", url): url,
            ogm.run("simulate", "--connect", endpoint, "--connect-timeout", 1): endpoint,
        }
        for ended, address in commands.items():
            complaint = ended.complaint(1)
            assert address in complaint
            assert "mapper` running there" in complaint or "is a mapper running there" in complaint
    assert not (ogm.folder / "map.png").exists()


def test_a_simulator_waits_for_a_mapper_that_starts_later(ogm, endpoint, eventually):
    waiting = f"waiting for a mapper or a Zenoh router at {endpoint}"
    early, gone = (ogm.start("simulate", "--connect", endpoint, "--scans", 3) for _ in range(2))
    early.complains(waiting)
    gone.complains(waiting)
    ended = gone.stop(signal.SIGINT)
    assert (ended.code, ended.out, ended.err.count(waiting)) == (0, "", 1)
    mapper = ogm.ready(ogm.start("mapper", "--http-port", 0, "--listen", endpoint))
    assert early.wait().code == 0
    eventually(lambda: mapper.status()["revision"] == 3)


def test_a_robot_that_is_alive_keeps_its_name(ogm, mapper, eventually):
    first = simulator(ogm, mapper, "--robots", 2)
    first.line("robot1, robot2 in lab")
    second = ogm.run("simulate", "--connect", mapper.endpoint, "--robots", 1)
    assert "'robot1' is publishing to map 'default' already" in second.complaint(1)
    assert "--robot-prefix" in second.err
    other = simulator(ogm, mapper, "--robot-prefix", "cart", "--scans", 2).wait()
    assert (other.code, other.out) == (0, "cart1 in lab: 20 scans a second each, at up to 3.43 m/s\n")
    first.kill()  # as a crash would: whose robots are gone at once
    eventually(lambda: ogm.run("simulate", "--connect", mapper.endpoint, "--scans", 1).code == 0)


def test_a_wrong_map_name_is_named(ogm, idle_mapper):
    status = ogm.call("status", "--url", idle_mapper.endpoint, "--map", "hall")
    get = ogm.call("get", "map.png", "-o", "x.png", "--url", idle_mapper.endpoint, "--map", "hall")
    for ended in (status, get):
        assert "no mapper of map 'hall' answered" in ended.complaint(1)
        assert "--map hall" in ended.err
    served = ogm.call("status", "--url", idle_mapper.url, "--map", "hall")
    assert "serves map 'default', and not 'hall'" in served.complaint(1)
    assert ogm.call("status", "--url", idle_mapper.url, "--map", "default").code == 0


def test_an_empty_map_has_no_picture(ogm, idle_mapper):
    complaint = ogm.call("get", "map.png", "-o", "x.png", "--url", idle_mapper.endpoint).complaint(1)
    assert "the map has no known cell yet" in complaint


def test_unknown_settings_are_named(ogm):
    ogm.file("ogm.yaml", "map: {resolutoin: 0.1}\n")
    commands = {
        "OGM_MAPPER__QUEU: unknown setting": ogm.run("mapper", OGM_MAPPER__QUEU="1"),
        "ogm.yaml: map.resolutoin: unknown setting": ogm.call("mapper", "--config", "ogm.yaml"),
        "OGM_HTTP__PORT": ogm.call("demo", OGM_HTTP__PORT="70000"),
        "OGM_NETWORK__NAME: unknown": ogm.call("simulate", OGM_NETWORK__NAME="x"),
    }
    for text, ended in commands.items():
        assert text in ended.complaint(2)


def test_a_stopped_mapper_writes_its_map_if_there_is_one(ogm, lab_recording, assert_equal_maps):
    mappers = [ogm.ready(command) for command in [ogm.mapper("--out", "full"), ogm.mapper("--out", "empty")]]
    endpoint = mappers[0].endpoint
    assert ogm.call("replay", lab_recording, "--speed", "max", "--connect", endpoint).code == 0
    served = mappers[0].map()
    assert mappers[0].command.stop().code == 0
    assert_equal_maps(ogm.map("full/map.npz"), served)
    ended = mappers[1].command.stop()
    assert (ended.code, ended.warnings.count("\n")) == (0, 1)
    assert "no known cell" in ended.err
    assert list((ogm.folder / "empty").iterdir()) == []
