"""A running mapper's quality: the truth that simulators tell it, and its series, over HTTP and Zenoh."""

import json
import threading
import time

import pytest
import zenoh

from ogm_client.session import NetworkConfig, open_session
from ogm_core.quality.truth import truth_figures
from ogm_core.simulation.catalogue import office
from ogm_core.simulation.worlds import dump_world, lab, load_world
from ogm_services.mapper.live import history as series_module
from ogm_services.mapper.live import live_figures as live_figures_module
from ogm_services.mapper.live import monitor as monitor_module
from ogm_services.mapper.live.history import Sample
from ogm_services.mapper.serving import zenoh_routes as zenoh_routes_module

WORLD = load_world("{walls: [[2.25, -3, 2.25, 3], [-3, 1.75, 3, 1.75]], path: {circle: [0, 0, 1], poses: 4}}")
TEXT = dump_world(WORLD)
NO_SAMPLES = {name: [] for name in Sample._fields}
FIELDS = ["accuracy", "precision", "recall", "iou", "log_loss"]


@pytest.fixture(autouse=True)
def looking_often(monkeypatch):
    """So that nothing takes a second."""
    monkeypatch.setattr(monitor_module, "LOOK_PERIOD", 0.01)
    monkeypatch.setattr(monitor_module, "REST", 0.0)
    monkeypatch.setattr(series_module, "PERIOD", 0.0)
    monkeypatch.setattr(series_module, "REST", 0.0)
    monkeypatch.setattr(live_figures_module, "FIGURES_PERIOD", 0.0)


def simulator(session, answer, *, complete=False):
    """Answer for the truth as `answer(query)` does; Zenoh prefers who claims to be complete."""
    handler = zenoh.handlers.Callback(answer, indirect=False)
    return session.declare_queryable("ogm/v1/hall/truth", handler, complete=complete)


def telling(text):
    """Tells a text."""

    def answer(query):
        with query:
            query.reply("ogm/v1/hall/truth", text)

    return answer


def quality(mapper):
    """What HTTP says, which is what Zenoh says."""
    body = mapper.http.get("/quality").raise_for_status().json()
    assert list(body)[-2:] == ["truth", "series"]
    return body


def test_without_a_simulator_there_is_no_truth(mapper, eventually):
    mapper.draw_cross()
    eventually(lambda: quality(mapper)["series"]["revision"])
    assert quality(mapper)["truth"] is None
    assert json.loads(mapper.answer("quality").payload.to_bytes())["truth"] is None


def test_the_truth_is_that_of_the_world_that_a_simulator_tells(mapper, eventually):
    mapper.draw_cross()
    telling_it = simulator(mapper.session, telling(TEXT))
    truth = eventually(lambda: quality(mapper)["truth"])
    assert truth == truth_figures(mapper.service.live_map.snapshot(), WORLD)
    assert list(truth) == FIELDS
    # Known are 14 cells, 3 of them walls; the one in the west is not in that world.
    assert truth["precision"] == pytest.approx(2 / 3)
    assert truth["accuracy"] == pytest.approx(13 / 14)
    assert json.loads(mapper.answer("quality").payload.to_bytes())["truth"] == truth
    telling_it.undeclare()
    eventually(lambda: quality(mapper)["truth"] is None)


def test_what_is_no_world_is_no_truth_and_harms_nothing(mapper, eventually, caplog):
    mapper.draw_cross()
    nonsense = simulator(mapper.session, telling("walls: of paper"))
    eventually(lambda: caplog.records)
    assert quality(mapper)["truth"] is None
    assert mapper.answer("quality")
    (record,) = caplog.records
    assert "a simulator's world: passed over: walls: a list of" in record.getMessage()
    simulator(mapper.session, telling(TEXT))
    nonsense.undeclare()
    eventually(lambda: quality(mapper)["truth"])


def test_a_world_without_end_does_not_end_the_mapper(mapper, eventually, caplog):
    mapper.draw_cross()
    simulator(mapper.session, telling("a: " + "[" * 200_000))
    eventually(lambda: caplog.records)
    message = caplog.records[0].getMessage()
    assert "a simulator's world: passed over: not YAML that can be read (" in message
    # Ours, or those of a libyaml that has a limit, too.
    assert any(words in message for words in ("more than 50 deep", "exceeded maximum nesting depth"))
    assert quality(mapper)["truth"] is None
    assert mapper.status()["revision"] == 3


def test_of_two_simulators_one_counts(mapper, eventually):
    mapper.draw_cross()
    told = sorted((dump_world(lab()), dump_world(office())))
    expected = [truth_figures(mapper.service.live_map.snapshot(), load_world(text)) for text in told]
    assert expected[0] != expected[1]
    with open_session(NetworkConfig(connect=(mapper.endpoint,))) as other:
        simulator(mapper.session, telling(told[1]), complete=True)
        eventually(lambda: quality(mapper)["truth"] == expected[1])
        simulator(other, telling(told[0]))
        eventually(lambda: quality(mapper)["truth"] == expected[0])
        heard = mapper.service.parts.monitor.truth._read
        assert [text.decode() for text in heard] == told
    eventually(lambda: quality(mapper)["truth"] == expected[1])


def test_so_many_answers_are_looked_at_whoever_gives_them(mapper, eventually, monkeypatch):
    monkeypatch.setattr(zenoh_routes_module, "MAX_TOLD", 2)

    def talk(query):
        with query:
            for k in range(5):
                query.reply("ogm/v1/hall/truth", f"{{{k}: 0}}")

    simulator(mapper.session, talk)
    eventually(lambda: len(mapper.service.parts.monitor.truth._read) == 2)


def test_a_simulator_that_does_not_answer_holds_nobody_up(start_mapper, eventually, monkeypatch):
    monkeypatch.setattr(zenoh_routes_module, "TRUTH_TIMEOUT", 20.0)
    held = []
    with start_mapper() as mapper:
        simulator(mapper.session, held.append)
        mapper.draw_cross()
        eventually(lambda: held)
        for _ in range(10):
            assert quality(mapper)["truth"] is None
        assert len(held) == 1  # all ten were answered while the simulator was
        held.clear()


def test_a_simulator_that_does_not_answer_is_asked_again_and_the_mapper_ends(start_mapper, eventually):
    held = []
    with start_mapper() as mapper:
        simulator(mapper.session, held.append)
        eventually(lambda: len(held) > 1)
        started = time.monotonic()
        mapper.service.__exit__(None, None, None)
        assert time.monotonic() - started < 20.0
        held.clear()


def test_what_a_stopped_mapper_leaves_is_judged_by_the_last_world(start_mapper, eventually):
    with start_mapper(map={"resolution": 0.5}) as mapper:
        telling_it = simulator(mapper.session, telling(TEXT))
        mapper.draw_cross()
        eventually(lambda: quality(mapper)["truth"])
        telling_it.undeclare()
        eventually(lambda: quality(mapper)["truth"] is None)
        eventually(lambda: quality(mapper)["series"]["revision"][-1:] == [3])
    fields = mapper.service.answers.quality_fields(fresh=True)
    assert fields["truth"] == truth_figures(mapper.service.live_map.snapshot(), WORLD)
    assert (fields["scans"], fields["series"]["revision"][-1]) == (3, 3)


def test_the_series_grows_with_the_map_and_begins_again_with_it(mapper, eventually):
    assert quality(mapper)["series"] == NO_SAMPLES
    mapper.draw_cross()
    eventually(lambda: quality(mapper)["series"]["revision"][-1:] == [3])
    mapper.draw_cross(revision=3)
    series = eventually(lambda: (s := quality(mapper)["series"])["revision"][-1:] == [6] and s)
    assert len({len(column) for column in series.values()}) == 1
    assert series["stamp"][-1] == mapper.status()["stamp"]
    assert series["known_m2"][-1] == 14 * 0.25
    assert series["entropy_bits"][-1] == quality(mapper)["entropy_bits"]
    assert series["mean_entropy_bits"][-1] == quality(mapper)["mean_entropy_bits"]
    mapper.http.post("/reset").raise_for_status()
    assert quality(mapper)["series"] == NO_SAMPLES


def test_its_monitor_is_a_thread_of_its_own_and_ends_with_the_mapper(start_mapper):
    def monitors():
        return [thread.name for thread in threading.enumerate()].count("ogm-monitor")

    before = monitors()
    with start_mapper():
        assert monitors() == before + 1
    assert monitors() == before
