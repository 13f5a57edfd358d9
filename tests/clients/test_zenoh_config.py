"""Clients whose way to the mapper stands in a Zenoh configuration file."""

import re
import traceback

import pytest
import zenoh

from ogm_client import BadSetting, CannotConnect, ClientError, MapClient, RobotPublisher, session
from ogm_core.status import encode_status
from status_json import STATUS

NOWHERE = "tcp/127.0.0.1:1"


@pytest.fixture
def mapper(listener):
    """What stands for a mapper: it answers `status`, and hears robots."""

    def answer(query):
        with query:
            query.reply("ogm/v1/default/status", encode_status(STATUS))

    handlers = [zenoh.handlers.Callback(call, indirect=False) for call in (answer, print)]
    held = (
        listener.declare_queryable("ogm/v1/default/status", handlers[0]),
        listener.declare_subscriber("ogm/v1/default/robots/**", handlers[1]),
    )
    yield listener
    for declared in held:
        declared.undeclare()


@pytest.fixture
def file(tmp_path):
    """`file(text)`: a configuration file that finds nobody by itself, and what else it says."""

    def write(text):
        path = tmp_path / "client.json5"
        path.write_text(f"{{ // as people write it\n scouting: {{multicast: {{enabled: false}}}}, {text} }}")
        return path

    return write


def ask(**how):
    with MapClient(**how) as client:
        assert client.status() == STATUS


def publish(**how):
    with RobotPublisher("r1", wait=False, **how) as robot:
        robot.wait_for_mapper()
        assert robot.feedback() is not None


@pytest.mark.parametrize("use", [ask, publish])
def test_the_file_says_where_and_how_and_an_address_overrides_it(mapper, endpoint, file, use):
    for mode in ("client", "peer"):
        listen = "" if mode == "client" else ", listen: {endpoints: []}"
        use(zenoh_config=file(f'mode: "{mode}", connect: {{endpoints: ["{endpoint}"]}}{listen}'))
        use(zenoh_config=str(file(f'mode: "{mode}"{listen}')), address=endpoint)
    use(zenoh_config=file(f'mode: "client", connect: {{endpoints: ["{NOWHERE}"]}}'), address=endpoint)


@pytest.mark.parametrize("use", [ask, publish])
def test_what_is_wrong_with_a_file_is_one_line(file, tmp_path, use):
    def said(kind, **how):
        with pytest.raises(kind) as error:
            use(**how)
        assert "\n" not in str(error.value)
        return str(error.value)

    assert re.search(
        r"missing\.json5: no such file", said(BadSetting, zenoh_config=tmp_path / "missing.json5")
    )
    where = r"^zenoh_config \(--zenoh-config, OGM_NETWORK__ZENOH_CONFIG\): \S*client\.json5: "
    assert re.search(where, said(BadSetting, zenoh_config=file("nonsense: 1")))
    assert "path of a file" in said(BadSetting, zenoh_config=7)
    assert NOWHERE in said(
        CannotConnect, zenoh_config=file(f'mode: "client", connect: {{endpoints: ["{NOWHERE}"]}}')
    )
    assert said(CannotConnect, zenoh_config=file('mode: "client"'))
    tls = "tls/127.0.0.1:1"
    assert "a certificate that the other one's authority has signed" in said(
        CannotConnect, zenoh_config=file(f'mode: "client", connect: {{endpoints: ["{tls}"]}}')
    )


def test_what_does_not_go_together_is_refused(listener, file):
    config = file('mode: "client"')
    for make in (MapClient, lambda **how: RobotPublisher("r1", **how)):
        with pytest.raises(BadSetting, match="zenoh_config: an open session has"):
            make(zenoh_config=config, session=listener)
    with pytest.raises(BadSetting, match="zenoh_config: http://h:1 is asked over HTTP"):
        MapClient("http://h:1", zenoh_config=config)


def test_who_does_not_answer_is_named_by_the_file(listener, endpoint, file):
    config = file(f'mode: "client", connect: {{endpoints: ["{endpoint}"]}}')
    with (
        pytest.raises(ClientError, match=f"no mapper of map 'default' answered as {config} says"),
        MapClient(zenoh_config=config) as client,
    ):
        client.status()


def test_who_waits_where_tls_is_spoken_is_told_of_certificates(file, caplog, monkeypatch):
    monkeypatch.setattr(session, "CONNECT_TIMEOUT", 0.0)
    config = file('mode: "client", connect: {endpoints: ["tls/127.0.0.1:1"]}')
    with pytest.raises(CannotConnect):
        RobotPublisher("r1", zenoh_config=config, connect_timeout=2.0)
    (said,) = caplog.messages
    assert said.startswith(
        "waiting for a mapper or a Zenoh router at tls/127.0.0.1:1; with TLS each side needs"
    )


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('{\n mode: "client",\n passwort: "hunter2"}', "line 3: unknown field `passwort`, expected one of"),
        ('{transport: {link: {tx: {lease: "hunter2"}}}}', "line 1: error parsing number"),
        ('{connect: {timeout_ms: "hunter2\\" `hunter2"}}', "line 1: invalid type: string, expected i64"),
        (
            "{\n\ntransport: {auth: {usrpwd: {user: 424242}}}}",
            "line 3: invalid type: integer, expected ",
        ),
        ('{\n mode: "client", password: "hunter2\n"}', "line 2: no JSON5, expected "),
        ('{connect: {endpoints: ["tcp/a:1"]', "line 1: no JSON5, expected "),
        ("mode: client", "line 1: no JSON5, expected "),
        ("", "Empty config file"),
    ],
)
def test_an_error_names_the_line_of_the_file_and_no_value_that_stands_there(tmp_path, text, says):
    path = tmp_path / "of_mine.json5"
    path.write_text(text)
    with pytest.raises(BadSetting) as error:
        MapClient(zenoh_config=path)
    chain = "".join(traceback.format_exception(error.value))
    said = str(error.value)
    assert f"of_mine.json5: {'' if says[0] == 'E' else 'Zenoh does not take '}{says}" in said
    assert not re.search(r"hunter2|424242|Some\(|Message|\.rs|[{\n]", said)
    assert not re.search("hunter2|424242", chain.replace(repr(text), ""))


@pytest.mark.parametrize("use", [ask, publish])
def test_who_would_connect_as_a_user_is_not_named(file, use, caplog):
    for address in (
        "tcp/joe:hunter2@127.0.0.1:1",
        "joe:hunter2@127.0.0.1:1",
        "tcp/joe:hunter2@h",
    ):
        with pytest.raises((BadSetting, CannotConnect)) as error:
            use(address=address)
        assert re.search(r"\*\*\*@(127\.0\.0\.1|h)", str(error.value))
        assert "hunter2" not in str(error.value) + caplog.text
        with pytest.raises((BadSetting, CannotConnect)) as error:
            use(zenoh_config=file(f'mode: "client", connect: {{endpoints: ["{address}"]}}'))
        assert "hunter2" not in str(error.value) + caplog.text
