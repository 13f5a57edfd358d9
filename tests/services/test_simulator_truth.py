"""A simulator that runs live tells its world to whoever asks, until it ends."""

import json
import threading

import pytest
import zenoh

from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.catalogue import world_named
from ogm_core.simulation.worlds import dump_world, load_world
from ogm_services.commands import simulator as simulator_module
from ogm_services.commands.simulator import run_simulator
from ogm_services.commands.simulator_options import SimulatorOptions
from ogm_services.settings.settings import NetworkSettings

WORLD = """
name: a box
boxes: [[-2, -1.5, 2, 1.5]]
circles: [[0.3, 0.2, 0.1]]
path: {waypoints: [[-1, -1], [1, -1], [1, 1], [-1, 1]], spacing: 0.05}
"""


@pytest.fixture
def world_file(tmp_path):
    path = tmp_path / "box.yaml"
    path.write_text(WORLD)
    return str(path)


@pytest.fixture
def simulating(in_background, monkeypatch, eventually):
    """`simulating(endpoint, world)` runs a simulator until an event, which it returns, or the test's end."""
    monkeypatch.setattr(simulator_module, "WAIT_FOR_MAPPER", 0.1)
    started = []

    def ticks(ended):
        step = 0
        while not ended.wait(0.01):
            yield step, step
            step += 1

    def start(endpoint, world):
        ended = threading.Event()
        monkeypatch.setattr(simulator_module, "_ticks", lambda _: ticks(ended))
        network = NetworkSettings(map_name="hall", connect=(endpoint,))
        future = in_background(run_simulator, network, SimulatorOptions(world=world, seed=1))
        started.append((ended, future))
        return ended

    yield start
    for ended, future in started:
        ended.set()
        future.result(30.0)


def ask(session, selector="ogm/v1/hall/truth"):
    return list(session.get(selector, timeout=30.0))


@pytest.mark.parametrize("name", ["lab", "office"])
def test_what_it_tells_is_its_world(listener, endpoint, simulating, eventually, name):
    assert ask(listener) == []
    ended = simulating(endpoint, name)
    (reply,) = eventually(lambda: ask(listener))
    assert str(reply.ok.key_expr) == "ogm/v1/hall/truth"
    assert str(reply.ok.encoding) == "application/yaml"
    text = reply.ok.payload.to_string()
    assert text == dump_world(world_named(name))
    assert dump_world(load_world(text)) == text
    (again,) = ask(listener)
    assert again.ok.payload.to_string() == text
    ended.set()
    eventually(lambda: ask(listener) == [])
    eventually(lambda: not any(thread.name.startswith("ogm-query") for thread in threading.enumerate()))


def test_a_world_of_the_users_own(listener, endpoint, simulating, world_file, eventually):
    simulating(endpoint, world_file)
    (reply,) = eventually(lambda: ask(listener))
    told, given = load_world(reply.ok.payload.to_string()), load_world(WORLD)
    assert (told.name, told.path) == (given.name, given.path)
    assert told.circles.tolist() == given.circles.tolist()
    assert told.segments.tolist() == given.segments.tolist()


@pytest.mark.parametrize("room", [0, -1])
def test_a_world_that_mappers_will_pass_over_is_told_of(
    listener, endpoint, simulating, eventually, monkeypatch, caplog, room
):
    size = len(dump_world(world_named("lab")))
    monkeypatch.setattr(simulator_module, "MAX_TRUTH_BYTES", size + room)
    simulating(endpoint, "lab")
    eventually(lambda: ask(listener))
    said = f"mappers will pass over this world as the truth of their maps: its description takes {size} bytes"
    assert (said in caplog.text) == (room < 0)


def test_a_wildcard_is_answered_on_the_concrete_key_and_a_parameter_is_refused(
    listener, endpoint, simulating, eventually
):
    simulating(endpoint, "lab")
    eventually(lambda: ask(listener))
    (reply,) = ask(listener, "ogm/v1/*/t$*")
    assert str(reply.ok.key_expr) == "ogm/v1/hall/truth"
    (reply,) = ask(listener, "ogm/v1/hall/truth?format=png")
    assert str(reply.err.encoding) == "application/problem+json"
    problem = json.loads(reply.err.payload.to_bytes())
    assert (problem["status"], problem["type"]) == (400, "bad-parameter")
    assert problem["detail"] == "format: truth has no parameters"
    assert list(listener.get("ogm/v1/hall/truth", target=zenoh.QueryTarget.ALL_COMPLETE, timeout=30.0)) == []


def test_a_mapper_judges_its_map_by_it(mapper, simulating, world_file, eventually):
    simulating(mapper.endpoint, world_file)
    eventually(lambda: mapper.status()["revision"] > 20)
    truth = eventually(lambda: mapper.http.get("/quality").json()["truth"])
    assert list(truth) == ["accuracy", "precision", "recall", "iou", "log_loss"]
    assert truth["precision"] > 0.9
    assert truth["recall"] > 0.9
    assert truth_figures(mapper.service.live_map.snapshot(), load_world(WORLD))["precision"] > 0.9
    assert truth_figures(mapper.service.live_map.snapshot(), world_named("lab"))["precision"] < 0.8
