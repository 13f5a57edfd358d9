"""What the mapper answers, without a network: names and parameters in, bytes out, some of them kept."""

import io
import json
import math
import threading

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.errors import BadParameter, MapEmpty
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import Region
from ogm_core.pictures.map_picture import MapPicture
from ogm_core.placing.receipts import Receipts
from ogm_core.types import Pose, Scan
from ogm_services.mapper.live.live_map import LiveMap
from ogm_services.mapper.live.monitor import Monitor
from ogm_services.mapper.serving import map_formats as formats_module
from ogm_services.mapper.serving.answer_cache import BYTES_BESIDES
from ogm_services.mapper.serving.answers import Answers
from ogm_services.mapper.serving.map_formats import MAP_FORMATS
from ogm_services.replies.answer import UnknownName
from status_json import as_json

HERE = Pose(0.25, 0.25, 0.0)
HIT = math.log(0.7 / 0.3)


class Desk:
    """Answers about a map, and a count of how often each format was encoded."""

    def __init__(self, monkeypatch, settings):
        self.live = LiveMap(OccupancyGrid(settings, "epoch", "run"))
        self.receipts = Receipts()
        self.answers = Answers("hall", self.live, self.receipts, Monitor(self.live))
        self.encoded = []
        for name in ("json", "npz", "png", "pgm", "pgw", "yaml"):
            self._count(monkeypatch, name)

    def _count(self, monkeypatch, name):
        encode = getattr(formats_module, f"encode_{name}")

        def counted(*arguments, **options):
            self.encoded.append(name)
            return encode(*arguments, **options)

        monkeypatch.setattr(formats_module, f"encode_{name}", counted)
        if name == "png":  # that of the whole map is kept up to date
            png = MapPicture.png

            def counted_picture(*given, **options):
                self.encoded.append(name)
                return png(*given, **options)

            monkeypatch.setattr(MapPicture, "png", counted_picture)

    def scan(self, *ranges, pose=HERE, stamp=0):
        """Integrate beams to the east, north, west and south."""
        self.live.integrate(Scan(stamp, 0.0, math.pi / 2, 0.0, 8.0, np.array(ranges, np.float32)), pose)

    def cell(self, x, y):
        return json.loads(self.answers.cell({"x": x, "y": y}).body)


@pytest.fixture
def desk(monkeypatch):
    return Desk(monkeypatch, GridSettings(resolution=0.5))


@pytest.mark.parametrize("form", MAP_FORMATS)
def test_an_answer_is_kept_until_a_scan_comes(desk, form):
    desk.scan(2.0)
    first = desk.answers.map(form, {})
    assert desk.answers.map(form, {}) is first
    assert desk.encoded == [form]
    desk.scan(2.0)
    second = desk.answers.map(form, {})
    assert second is not first
    assert (first.etag, second.etag) == ('"epoch-run-1"', '"epoch-run-2"')
    assert (second.meta["revision"], desk.encoded) == (2, [form, form])


def test_a_reset_is_a_new_answer_even_at_an_old_revision(desk):
    first = desk.answers.map("json", {})
    desk.live.reset("other")
    second = desk.answers.map("json", {})
    assert (first.etag, second.etag) == ('"epoch-run-0"', '"other-run-0"')
    assert json.loads(second.body)["epoch"] == "other"


def test_an_answer_is_kept_by_its_format_and_parameters_in_any_order(desk):
    desk.scan(2.0)
    region = {"region": "0,0,1,1"}
    first = desk.answers.map("png", {"palette": "ros", **region})
    assert desk.answers.map("png", {**region, "palette": "ros"}) is first
    others = [
        ("png", region),
        ("png", {"palette": "probability", **region}),
        ("pgm", region),
        ("json", region),
    ]
    others += [("png", {"palette": "ros", "region": "0,0,1,1.0"})]
    for form, given in others:
        assert desk.answers.map(form, given) is not first
    assert len(desk.encoded) == 6
    assert desk.answers.map("png", {"palette": "ros", **region}) is first


def test_a_region_on_the_edges_of_cells_gives_exactly_these(monkeypatch):
    desk = Desk(monkeypatch, GridSettings(resolution=0.05))
    desk.scan(3.0, 3.0, 3.0, 3.0)
    for ix in range(-50, 60):
        west, east = ix * 0.05, (ix + 1) * 0.05
        answer = desk.answers.map("json", {"region": f"{west!r},{west!r},{east!r},{east!r}"})
        assert (answer.meta["width"], answer.meta["height"], answer.meta["offset"]) == (1, 1, [ix, ix])


def test_what_is_kept_is_bounded(desk):
    desk.scan(2.0)
    size = len(desk.answers.map("json", {}).body) + BYTES_BESIDES
    desk.answers._cache._room = 4 * size
    asked = [{"region": f"0,0,{9 + n},1"} for n in range(20)]
    bodies, kept = [], []
    for given in asked:
        bodies.append(desk.answers.map("json", given).body)
        kept.append(len(desk.answers._cache._answers))
    assert kept == [2, 3, 1] + [2, 3, 1] * 5 + [2, 3]
    assert len(set(bodies)) == 1
    desk.answers._cache._room = size - 1
    assert desk.answers.map("json", {}).body == desk.answers.map("json", {"region": "0,0,99,1"}).body


def test_an_error_is_not_kept(desk):
    for _ in range(2):
        with pytest.raises(MapEmpty):
            desk.answers.map("png", {})
    desk.scan(2.0)
    assert desk.answers.map("png", {}).body.startswith(b"\x89PNG")


def test_what_else_is_answered_has_no_validator(desk):
    for answer in (
        desk.answers.status({}),
        desk.answers.quality({}),
        desk.answers.cell({"x": "0", "y": "0"}),
    ):
        assert (answer.etag, answer.meta, answer.media_type) == (None, None, "application/json")


@pytest.mark.parametrize("form", ["", "PNG", "jpeg", "png "])
def test_an_unknown_format_is_told_with_those_there_are(desk, form):
    with pytest.raises(UnknownName, match="png, pgw, json, pgm, yaml, npz"):
        desk.answers.map(form, {})


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"regoin": "0,0,1,1"},
            "regoin: unknown parameter; there are: at, max_size, palette, region, resolution, transparent",
        ),
        ({"region": "0,0,1"}, "region: xmin,ymin,xmax,ymax is needed, got '0,0,1'"),
        ({"region": "0,0,1,x"}, "region: a number is needed, got 'x'"),
        ({"region": "7,7,8,8"}, "lies wholly outside the map, x 0.5 to 2.5, y 0 to 0.5 m"),
        ({"max_size": "0"}, "max_size: 1 to 999999999 is needed, got 0"),
        (
            {"palette": "grey"},
            "palette: one of ros, probability, cividis, dark, costmap is needed, got 'grey'",
        ),
    ],
)
def test_a_bad_parameter_is_told_with_what_to_do(desk, given, message):
    desk.scan(2.0)
    with pytest.raises(BadParameter) as error:
        desk.answers.map("png", given)
    assert message in str(error.value)


def test_cells(desk):
    desk.scan(2.0)
    known = desk.cell("2.0", "0.0")
    assert (known["ix"], known["iy"], known["known"]) == (4, 0, True)
    assert known["log_odds"] == pytest.approx(HIT, abs=3e-4)
    assert known["probability"] == pytest.approx(0.7, abs=1e-4)
    assert desk.cell("1.999", "0.499")["probability"] == pytest.approx(0.3, abs=1e-4)
    for x, y in (("0.25", "0.25"), ("2.5", "0.25"), ("2.0", "0.5"), ("2.0", "-1e-9"), ("-1e15", "1e15")):
        unknown = desk.cell(x, y)
        assert (unknown["known"], unknown["log_odds"], unknown["probability"]) == (False, None, None)
        assert (unknown["x"], unknown["ix"]) == (float(x), math.floor(float(x) / 0.5))


def test_a_cell_that_is_back_at_the_prior_is_known(desk):
    desk.scan(2.0)
    desk.scan(2.5)
    cell = desk.cell("2.0", "0")
    assert (cell["known"], cell["log_odds"], cell["probability"]) == (True, 0.0, 0.5)
    assert json.loads(desk.answers.map("json", {"values": "percent"}).body)["data"] == [16, 16, 16, 50, 70]


def test_a_float64_map_with_bounds(monkeypatch):
    settings = GridSettings(
        resolution=0.5,
        cell_model=LogOdds(cells="float64"),
        bounds=Region(-1.0, -2.0, 5.0, 2.0),
        outside="drop",
    )
    desk = Desk(monkeypatch, settings)
    desk.scan(2.0)
    cell = desk.cell("2.2", "0.2")
    assert (cell["ix"], cell["iy"], cell["log_odds"]) == (6, 4, settings.cell_model.d_occ)
    with np.load(io.BytesIO(desk.answers.map("npz", {}).body)) as npz:
        log_odds = npz["log_odds"]
        assert (log_odds.dtype, log_odds.shape) == (np.float64, (8, 12))
        assert npz["anchor"].tolist() == npz["origin"].tolist() == [-1.0, -2.0]
    assert log_odds[4, 6] == cell["log_odds"]
    assert np.count_nonzero(~np.isnan(log_odds)) == 4


def test_status_is_of_the_map_and_the_books(desk):
    desk.receipts.pose_received("r")
    desk.receipts.scan_received("r", "s")
    desk.scan(2.0, stamp=7)
    desk.receipts.scan_integrated("r", "s")
    status = json.loads(desk.answers.status({}).body)
    assert (status["map"], status["epoch"], status["revision"], status["stamp"]) == ("hall", "epoch", 1, 7)
    counts = as_json(desk.receipts.status())
    assert {name: status[name] for name in counts} == counts
    assert counts["scans"]["integrated"] == counts["robots"]["r"]["sources"]["s"]["received"] == 1
    assert status["map_info"] == as_json(desk.live.info())


def test_answers_to_many_threads_are_those_to_one(desk):
    desk.scan(2.0, 1.0, 1.5, 0.5)
    asked = [(form, {"region": f"-{n},-9,9,9"}) for form in MAP_FORMATS for n in range(1, 5)]
    alone = {repr(each): desk.answers.map(*each).body for each in asked}
    wrong = []

    def ask(order):
        for each in order * 5:
            answer = desk.answers.map(*each)
            if answer.body != alone[repr(each)] or answer.etag != '"epoch-run-1"':
                wrong.append(each)

    threads = [threading.Thread(target=ask, args=(asked[n:] + asked[:n],)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20.0)
    assert wrong == []


def test_quality_may_be_old_and_a_fresh_one_is_not(desk):
    assert json.loads(desk.answers.quality({}).body)["scans"] == 0
    desk.scan(2.0)
    assert json.loads(desk.answers.quality({}).body)["scans"] == 0
    fresh = desk.answers.quality_fields(fresh=True)
    assert (fresh["scans"], fresh["known_m2"], fresh["truth"]) == (1, 1.0, None)
    assert fresh["series"]["revision"] == []  # nobody has started the monitor


def test_who_comes_while_a_map_is_encoded_shares_the_next(desk, monkeypatch, eventually):
    """Nobody gets a map that is older than his question, and nothing is encoded twice."""
    desk.scan(2.0)
    encode, entered, go_on = MapPicture.png, threading.Event(), threading.Event()

    def slow(*arguments):
        entered.set()
        assert go_on.wait(30.0)
        return encode(*arguments)

    monkeypatch.setattr(MapPicture, "png", slow)
    answers = []

    def ask():
        answers.append(desk.answers.map("png", {}))

    threads = [threading.Thread(target=ask)]
    threads[0].start()
    assert entered.wait(30.0)
    desk.scan(3.0)
    threads += [threading.Thread(target=ask) for _ in range(8)]
    for thread in threads[1:]:
        thread.start()
    eventually(lambda: desk.answers._cache._turns["png", ()].wanted == 9)
    # Neither the writer nor the status waits for an encoder.
    desk.scan(3.5)
    assert json.loads(desk.answers.status({}).body)["revision"] == 3
    go_on.set()
    for thread in threads:
        thread.join(30.0)
    assert sorted(answer.meta["revision"] for answer in answers) == [1] + [3] * 8
    assert len({id(answer) for answer in answers}) == 2
    assert desk.encoded == ["png", "png"]
    assert not desk.answers._cache._turns


def test_an_old_map_does_not_push_out_a_newer_one(desk):
    desk.scan(2.0)
    old = desk.live.now
    desk.scan(3.0)
    newest = desk.answers.map("json", {})
    desk.answers._cache.keep(("png", ()), old, newest)
    assert desk.answers.map("json", {}) is newest
    assert desk.answers._cache.find(("png", ()), old) is None


def test_a_map_of_before_a_reset_that_is_encoded_late_does_not_push_out_the_new_ones(desk, monkeypatch):
    desk.scan(2.0)
    encode, entered, go_on = MapPicture.png, threading.Event(), threading.Event()

    def slow(*arguments):
        entered.set()
        assert go_on.wait(10.0)
        return encode(*arguments)

    monkeypatch.setattr(MapPicture, "png", slow)
    late = []
    thread = threading.Thread(target=lambda: late.append(desk.answers.map("png", {})))
    thread.start()
    assert entered.wait(10.0)
    desk.live.reset("other")
    newest = desk.answers.map("json", {})
    go_on.set()
    thread.join(10.0)
    assert late[0].etag == '"epoch-run-1"'
    assert newest.etag == '"other-run-0"'
    assert desk.answers.map("json", {}) is newest
    assert desk.encoded == ["json", "png"]
