"""Two mappers of one map: a tie at the start, newcomers, tokens without a mapper, and two that meet later."""

import json
import logging
import threading
import time
from contextlib import ExitStack, closing, suppress

import pytest
import zenoh

from ogm_client.session import NetworkConfig, open_session, resolve_listen
from ogm_core.wire.keys import MapKeys
from ogm_services.mapper.serving import other_mappers
from ogm_services.mapper.serving.health import Health
from ogm_services.mapper.serving.other_mappers import AlreadyMapped, OtherMappers

KEYS = MapKeys("hall")
LOW, HIGH = "0" * 32, "f" * 32
PERIOD = 0.02


@pytest.fixture
def joined(listener, endpoint):
    """`joined()` opens one more session; all of them see each other through `listener`."""
    with ExitStack() as opened:
        yield lambda: opened.enter_context(open_session(NetworkConfig(connect=(endpoint,))))


@pytest.fixture
def mapper(joined):
    """`mapper(run)`: a mapper's claim on a session of its own."""
    with ExitStack() as opened:
        yield lambda run=None: opened.enter_context(
            closing(OtherMappers(joined(), KEYS, run=run, period=PERIOD))
        )


def serving(others):
    others.claim()
    others.serve()
    return others


def state_of(session, run):
    (reply,) = session.get(KEYS.alive("mapper", "*", run), timeout=10.0)
    return json.loads(reply.ok.payload.to_bytes())["state"]


def at_once(*mappers):
    """Start them at the same moment; which of them serve, in order."""
    gate, served = threading.Barrier(len(mappers)), []

    def start(others):
        gate.wait()
        try:
            serving(others)
        except AlreadyMapped:
            others.close()  # as a mapper that ends
        else:
            served.append(others)

    threads = [threading.Thread(target=start, args=(others,)) for others in mappers]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return served


def test_of_two_that_start_at_the_same_moment_exactly_one_stays(joined):
    """Twenty times, with fresh runs: which of the two is asked first is chance, and that one stays is not."""
    sessions = joined(), joined()
    for _ in range(20):
        mappers = [OtherMappers(session, KEYS, period=PERIOD) for session in sessions]
        served = at_once(*mappers)
        assert len(served) == 1
        assert served[0].rivals == frozenset()
        served[0].close()


def test_of_five_that_start_at_the_same_moment_exactly_one_stays(mapper):
    assert len(at_once(*(mapper() for _ in range(5)))) == 1


def test_peers_that_nobody_stands_between_come_to_one_end_as_well(listener, joined):
    for _ in range(10):
        mappers = [OtherMappers(session, KEYS, period=PERIOD) for session in (listener, joined())]
        (stays,) = at_once(*mappers)
        stays.close()


@pytest.mark.parametrize("first", [LOW, HIGH])
def test_while_both_start_the_lower_run_stays_whoever_came_first(mapper, first, in_background):
    early, late = mapper(first), mapper(HIGH if first == LOW else LOW)
    early.claim()
    if first == LOW:
        with pytest.raises(AlreadyMapped, match=f"another mapper of map 'hall' is alive .*/{LOW}.*--map"):
            late.claim()
        early.serve()
    else:
        late.claim()
        takes_it = in_background(late.serve)  # it waits for the other one to give up
        with pytest.raises(AlreadyMapped, match=LOW):
            early.serve()
        takes_it.result(30.0)


def test_one_that_serves_stays_though_a_newcomer_has_a_lower_run(mapper, joined):
    serving(mapper(HIGH))
    with pytest.raises(AlreadyMapped, match=HIGH):
        mapper(LOW).claim()
    assert state_of(joined(), HIGH) == "serving"


def served_by(session, answers):
    """Declare who answers as mappers do, with these (key, payload)."""

    def answer(query):
        with query:
            for key, payload in answers:
                query.reply(key, payload)

    handler = zenoh.handlers.Callback(answer, indirect=False)
    return session.declare_queryable(f"{KEYS.root}/alive/mapper/**", handler)


def says(run, state):
    return json.dumps({"run": run, "state": state})


def test_one_that_starts_gives_up_for_one_that_serves_by_now(mapper, joined, eventually):
    """As one that was frozen does, which comes back while another is about to take its map."""
    starting, back = mapper(LOW), joined()
    starting.claim()
    other = KEYS.alive("mapper", "other", HIGH)
    _held = served_by(back, [(other, says(HIGH, "serving"))])
    eventually(lambda: [*joined().get(other, timeout=10.0)])
    with pytest.raises(AlreadyMapped, match=HIGH):
        starting.serve()
    assert state_of(joined(), LOW) == "yielding"


def test_questions_in_a_mapper_s_name_stop_no_mapper_however_often_and_under_however_many_names(
    mapper, joined
):
    """Two hundred names at least, each both as one that starts and as one that serves, and tokens of them."""
    stranger, starting, stop, names = joined(), mapper(HIGH), threading.Event(), []
    tokens = ExitStack()

    def insist():
        while not stop.is_set() or len(names) < 200:
            names.append(f"{len(names):032}")
            if len(names) < 50:
                token = KEYS.alive("mapper", "evil", names[-1])
                tokens.push(stranger.liveliness().declare_token(token))
            for state in ("starting", "serving"):
                pattern = KEYS.alive("mapper", "*", "*")
                assert [*stranger.get(f"{pattern}?run={names[-1]};state={state}", timeout=10.0)]

    starting.claim()
    thread = threading.Thread(target=insist)
    thread.start()
    try:
        starting.serve()
    finally:
        stop.set()
        thread.join()
        tokens.close()
    assert state_of(joined(), HIGH) == "serving"
    assert starting.reasons() == []


def test_who_says_to_start_and_never_does_is_waited_for_and_no_longer(mapper, joined, monkeypatch):
    monkeypatch.setattr(other_mappers, "SETTLED", 0.5)
    looks = []

    def answer(query):
        looks.append(time.monotonic())
        with query:
            query.reply(KEYS.alive("mapper", "other", HIGH), says(HIGH, "starting"))

    handler = zenoh.handlers.Callback(answer, indirect=False)
    _held = joined().declare_queryable(f"{KEYS.root}/alive/mapper/**", handler)
    others = serving(mapper(LOW))
    assert len(looks) >= 3
    assert others.reasons() == []


def test_a_start_waits_for_one_that_has_looked_too_early_to_see_it(mapper, joined):
    """Which then serves: the lower run gives up, though it was there before that one served."""
    states = iter(["starting"] * 3)

    def answer(query):
        with query:
            query.reply(KEYS.alive("mapper", "other", HIGH), says(HIGH, next(states, "serving")))

    handler = zenoh.handlers.Callback(answer, indirect=False)
    _held = joined().declare_queryable(f"{KEYS.root}/alive/mapper/**", handler)
    low = mapper(LOW)
    low.claim()
    with pytest.raises(AlreadyMapped, match=HIGH):
        low.serve()


def test_one_whose_rival_ends_takes_the_map_itself(mapper, joined):
    early, late = mapper(HIGH), mapper(LOW)
    early.claim()
    late.claim()
    late.close()
    early.serve()
    assert state_of(joined(), HIGH) == "serving"


def test_a_bare_token_stops_nobody_and_is_named(mapper, joined, eventually, caplog):
    token = KEYS.alive("mapper", "evil", LOW)
    _held = joined().liveliness().declare_token(token)
    eventually(lambda: [*joined().liveliness().get(token)])
    others = serving(mapper())
    assert [(r.levelname, token in r.getMessage()) for r in caplog.records] == [("WARNING", True)]
    assert others.reasons() == []


@pytest.mark.parametrize("comes", [True, False], ids=["comes", "goes"])
def test_one_that_comes_or_goes_during_the_look_is_no_bare_token(
    mapper, joined, eventually, caplog, monkeypatch, comes
):
    low, high = mapper(LOW), mapper(HIGH)
    if not comes:
        high.claim()
    look = OtherMappers._look_before_serving

    def meanwhile(others):
        if others is not low:
            return look(others)
        if comes:
            seen = look(low)
            with suppress(AlreadyMapped):
                high.claim()
        else:
            high.close()
            eventually(lambda: not [*joined().liveliness().get(KEYS.alive("mapper", "*", HIGH))])
            seen = look(low)
        return seen

    monkeypatch.setattr(OtherMappers, "_look_before_serving", meanwhile)
    low.claim()
    assert caplog.messages == []


@pytest.mark.parametrize(
    "reply",
    [
        *(b"", b"\xff", b"[" * 100_000, b"[]", b'{"run": 1}', b'{"state": "serving"}'),
        *(says(LOW, "asleep"), says(LOW, ["serving"]), says(HIGH, "serving"), says("", "serving")),
    ],
)
def test_who_answers_something_else_is_no_mapper(mapper, joined, eventually, reply):
    key = KEYS.alive("mapper", "evil", LOW)

    def answer(query):
        with query:
            query.reply(key, reply)

    _held = joined().declare_queryable(key, zenoh.handlers.Callback(answer, indirect=False))
    eventually(lambda: [*joined().get(key, timeout=10.0)])
    assert serving(mapper()).reasons() == []


def test_strangers_in_any_number_cost_little_and_are_named_in_a_line(mapper, joined, eventually, caplog):
    serves = says(LOW, "serving")
    others = serving(mapper())
    keys = [KEYS.alive("mapper", f"evil{n:04d}", LOW) for n in range(2000)]
    _held = served_by(joined(), [(key, serves) for key in keys])
    eventually(lambda: len(others.rivals) == 16)
    (reason,) = others.reasons()
    named = ", ".join(keys[:3])
    assert reason == f"another mapper of the map serves, too: {named} and 13 more"
    (record,) = caplog.records
    assert named in record.getMessage()
    assert "and 13 more" in record.getMessage()


@pytest.mark.parametrize(
    ("key", "payload"),
    [
        (KEYS.alive("mapper", "evil", LOW), says(LOW, "serving") + " " * 240),
        (KEYS.alive("mapper", "e" * 65, LOW), says(LOW, "serving")),
        (KEYS.alive("mapper", "evil", "r" * 65), says("r" * 65, "serving")),
        (KEYS.alive("mapper", "\x1b[31m\nready", LOW), says(LOW, "serving")),
    ],
)
def test_who_answers_too_long_or_under_no_name_is_no_mapper(mapper, joined, eventually, key, payload):
    stranger = joined()
    _held = served_by(stranger, [(key, payload)])
    eventually(lambda: [*joined().get(KEYS.alive("mapper", "*", "*"), timeout=10.0)])
    assert serving(mapper()).reasons() == []


def test_tokens_in_any_number_are_warned_of_in_one_line(mapper, joined, eventually, caplog):
    stranger = joined()
    _held = [
        stranger.liveliness().declare_token(KEYS.alive("mapper", f"evil{n:03d}", LOW)) for n in range(100)
    ]
    pattern = KEYS.alive("mapper", "*", "*")
    eventually(lambda: len([*joined().liveliness().get(pattern)]) == 100)
    serving(mapper())
    (record,) = caplog.records
    assert record.getMessage().count("evil") == 3
    assert "more: the token" in record.getMessage()
    assert len(record.getMessage()) < 500


def test_why_it_is_not_ready_is_one_printable_line():
    health = Health(alive=lambda: True, reasons=[lambda: None, lambda: "a\n\x1b[31mb", lambda: "c"])
    assert health.not_ready() == "a??[31mb; c"


def test_who_has_answered_once_makes_a_mapper_unready_for_one_look(mapper, joined, eventually):
    others, answered = serving(mapper()), []

    def answer(query):
        with query:
            if not answered:
                query.reply(KEYS.alive("mapper", "evil", LOW), says(LOW, "serving"))
            answered.append(others.reasons())

    handler = zenoh.handlers.Callback(answer, indirect=False)
    _held = joined().declare_queryable(f"{KEYS.root}/alive/mapper/**", handler)
    eventually(lambda: len(answered) >= 4)
    assert [bool(reasons) for reasons in answered[:4]] == [False, True, False, False]


def test_a_token_beside_one_that_serves_changes_nothing(mapper, joined, eventually, caplog):
    others, stranger, asked = serving(mapper()), joined(), []
    key = KEYS.alive("mapper", "evil", LOW)

    def say_nothing(query):
        with query:
            asked.append(query)

    _token = stranger.liveliness().declare_token(key)
    _held = stranger.declare_queryable(key, zenoh.handlers.Callback(say_nothing, indirect=False))
    eventually(lambda: len(asked) >= 3)
    assert (others.reasons(), caplog.records) == ([], [])


def test_a_mapper_beside_another_is_not_ready_and_goes_on_all_the_same(start_mapper, eventually):
    """Whoever may answer as a mapper does can say that a mapper is not alone, and no more."""
    key = MapKeys("hall").alive("mapper", "other", LOW)

    def serve(query):
        with query:
            query.reply(key, says(LOW, "serving"))

    with start_mapper(map={"resolution": 0.5}) as mapper:
        assert mapper.http.get("/readyz").text == "ok"
        held = mapper.session.declare_queryable(key, zenoh.handlers.Callback(serve, indirect=False))
        answer = eventually(lambda: (a := mapper.http.get("/readyz")).status_code == 503 and a)
        assert answer.text == f"another mapper of the map serves, too: {key}"
        assert mapper.http.get("/livez").status_code == 200
        assert mapper.draw_cross()["revision"] == 3
        assert mapper.answer("map", "format=npz").payload.to_bytes() == mapper.http.get("/map.npz").content
        held.undeclare()
        eventually(lambda: mapper.http.get("/readyz").status_code == 200)


@pytest.fixture
def router():
    """`router(listen=endpoint)` or `router(connect=endpoints)`: a Zenoh router of this process."""

    def start(**endpoints):
        config = zenoh.Config()
        config.insert_json5("mode", '"router"')
        config.insert_json5("scouting/multicast/enabled", "false")
        for key in ("listen", "connect"):
            config.insert_json5(f"{key}/endpoints", json.dumps(endpoints.get(key, [])))
        return zenoh.open(config)

    return start


def test_two_that_meet_between_claim_and_start_agree_who_stays(router, eventually):
    ends = [resolve_listen("tcp/127.0.0.1:0") for _ in range(2)]
    with ExitStack() as opened:
        mappers, sessions = [], []
        for run, endpoint in zip((LOW, HIGH), ends, strict=True):  # each on a network of its own
            opened.enter_context(router(listen=[endpoint]))
            session = opened.enter_context(open_session(NetworkConfig(connect=(endpoint,))))
            others = opened.enter_context(closing(OtherMappers(session, KEYS, run=run, period=PERIOD)))
            others.claim()
            mappers.append(others)
            sessions.append(session)
        opened.enter_context(router(connect=ends))
        for session, theirs in zip(sessions, (HIGH, LOW), strict=True):
            eventually(lambda s=session, run=theirs: [*s.get(KEYS.alive("mapper", "*", run), timeout=10.0)])
        low, high = mappers
        with pytest.raises(AlreadyMapped, match=LOW):
            high.serve()
        low.serve()


def test_two_that_meet_later_both_say_so_once_and_when_it_is_over(router, eventually, caplog):
    caplog.set_level(logging.WARNING)
    ends = [resolve_listen("tcp/127.0.0.1:0") for _ in range(2)]
    with ExitStack() as opened:
        mappers = []
        for run, endpoint in zip((LOW, HIGH), ends, strict=True):  # each on a network of its own
            opened.enter_context(router(listen=[endpoint]))
            session = opened.enter_context(open_session(NetworkConfig(connect=(endpoint,))))
            others = opened.enter_context(closing(OtherMappers(session, KEYS, run=run, period=PERIOD)))
            mappers.append(serving(others))
        assert [others.reasons() for others in mappers] == [[], []]
        with router(connect=ends):
            eventually(lambda: all(others.reasons() for others in mappers))
            for others, theirs in zip(mappers, (HIGH, LOW), strict=True):
                (reason,) = others.reasons()
                assert "another mapper of the map serves, too: " in reason
                assert theirs in reason
        eventually(lambda: not any(others.reasons() for others in mappers))
    for run in (LOW, HIGH):
        said = [(r.levelname, r.getMessage()) for r in caplog.records if run in r.getMessage()]
        assert [level for level, _ in said] == ["ERROR", "WARNING"]
        assert "another mapper of map 'hall' serves, too" in said[0][1]
        assert "the other mapper of map 'hall' is gone" in said[1][1]
