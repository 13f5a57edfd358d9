"""docker/zenoh's files with certificates made as docs/security.md says: who is let in, and to what.

One mapper for all rows, which come in order: robot1's map, what must not change it, and at last a reset.
"""

import itertools
import json
import re
import subprocess
import time
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import zenoh
import zenoh.ext

from ogm_client import CannotConnect, MapClient, MapperError, NobodyAnswered, NotHeard, RobotPublisher
from ogm_client.session import NetworkConfig, open_session, resolve_listen
from ogm_core.errors import BadRecording
from ogm_core.wire.map_update import decode_updates
from ogm_services.ros2.mcap_reader import McapReader

ROOT = Path(__file__).parents[2]
CERTIFICATES = re.search(r"```sh\n(mkdir -p certs\n.*?)```", (ROOT / "docs/security.md").read_text(), re.S)[1]
SWEEP = {"angle_min": -0.5, "angle_increment": 0.25, "range_min": 0.1, "range_max": 30.0}
MAPPER, OWN = "ogm/v1/default/alive/mapper/evil", "ogm/v1/default"
AUTHORITY = """
[ca]
default_ca = ours
[ours]
database = index.txt
new_certs_dir = .
serial = serial
default_md = sha256
policy = names
copy_extensions = copy
[names]
commonName = supplied
"""


class Site:
    """A folder with certificates, and the shipped files with its paths, a free port and a name in them."""

    def __init__(self, folder):
        self.folder = folder
        self._numbers = itertools.count()
        self.endpoint = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/")
        subprocess.run(["sh", "-euc", CERTIFICATES], cwd=folder, check=True, capture_output=True)

    def mapper(self, edit=lambda text: text, endpoint=None):
        """mapper.json5, listening on loopback."""
        text = edit((ROOT / "docker/zenoh/mapper.json5").read_text())
        assert "tls/0.0.0.0:7447" in text
        return self._written("mapper", text.replace("tls/0.0.0.0:7447", endpoint or self.endpoint))

    def client(self, name, endpoint=None, edit=lambda text: text):
        """client.json5 of whoever has that certificate."""
        text = edit((ROOT / "docker/zenoh/client.json5").read_text())
        assert text.count("// <--") == len(
            re.findall(r"(?m)^.*(?:127\.0\.0\.1|certs/robot1\.).*// <--$", text)
        )
        text = text.replace("tls/127.0.0.1:7447", endpoint or self.endpoint)
        return self._written(f"client-{name}", text.replace("certs/robot1.", f"certs/{name}."))

    def expiring(self, name, seconds):
        """Make a certificate `expiring` of that name, for some seconds."""
        end = datetime.now(UTC) + timedelta(seconds=seconds)
        (self.folder / "ca.cnf").write_text(AUTHORITY)
        (self.folder / "index.txt").touch()
        request = f"openssl req -newkey rsa:2048 -nodes -subj /CN={name} -addext extendedKeyUsage=clientAuth"
        sign = (
            "openssl ca -batch -config ca.cnf -cert certs/ca.pem -keyfile certs/ca.key -rand_serial -notext"
        )
        for command in (
            f"{request} -keyout certs/expiring.key -out request.csr",
            f"{sign} -enddate {end:%y%m%d%H%M%SZ} -in request.csr -out certs/expiring.pem",
        ):
            subprocess.run(command.split(), cwd=self.folder, check=True, capture_output=True)

    def _written(self, name, text):
        path = self.folder / f"{name}-{next(self._numbers)}.json5"
        path.write_text(text.replace('"certs/', f'"{self.folder}/certs/'))
        return path

    @contextmanager
    def session(self, name, **how):
        with open_session(NetworkConfig(config_file=self.client(name, **how))) as session:
            yield session

    def robot(self, name, of, **how):
        """A publisher of robot `name` with the certificate `of`."""
        return RobotPublisher(name, zenoh_config=self.client(of, **how), wait=False, reliable=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    return Site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def mapper(site, module_ogm, lab_recording):
    """A mapper that has robot1's lap through the lab."""
    flags = ["--zenoh-config", site.mapper()]
    mapper = module_ogm.ready(module_ogm.start("mapper", "--http-port", 0, *flags))
    lap = module_ogm.run("replay", lab_recording, "--speed", "max", "--zenoh-config", site.client("robot1"))
    assert lap.code == 0, lap
    assert mapper.status()["scans"]["integrated"] == 220
    return mapper


@pytest.fixture
def unchanged(mapper):
    """Asserts that a test has changed nothing of the map, and nothing of what was received."""

    def state():
        status = mapper.status()
        counts = [status[name] for name in ("epoch", "revision", "stamp", "scans", "poses", "other")]
        return counts, list(status["robots"]), mapper.get("map.npz")

    before = state()
    yield
    assert state() == before


@pytest.fixture
def looked(mapper, eventually):
    """`looked()` waits until the mapper has looked for truths and for other mappers twice more."""

    def wait():
        began = mapper.status()["uptime_s"]
        eventually(lambda: mapper.status()["uptime_s"] > began + 3.0)

    return wait


def no_certificate(text):
    return re.sub(r".*connect_(certificate|private_key).*\n", "", text)


def test_nobody_comes_in_without_a_certificate_of_ours(site, mapper, unchanged):
    forged = site.folder / "forged"
    forged.mkdir()
    subprocess.run(["sh", "-euc", CERTIFICATES], cwd=forged, check=True, capture_output=True)

    def self_signed(text):
        return re.sub(r'"certs/(robot1\.\w+)"', rf'"{forged}/certs/\1"', text)

    for edit in (no_certificate, self_signed):
        with pytest.raises(CannotConnect, match="with TLS each side needs a certificate"):
            site.robot("robot1", of="robot1", edit=edit)


def test_a_robot_puts_under_its_own_name_only_and_learns_what_is_denied(site, mapper, unchanged, eventually):
    """A robot under another's name, a viewer as a robot: both believe that they are heard until they ask."""
    with ExitStack() as opened:
        liars = [opened.enter_context(site.robot("robot1", of=name)) for name in ("robot2", "viewer")]
        stranger = opened.enter_context(site.robot("robot3", of="robot2"))
        liars[0].wait_for_mapper()  # which says no more than that somebody wants such messages

        def denied(robot):
            robot.publish_pose(9.0, 9.0, 0.0)
            robot.publish_scan([1.0] * 5, **SWEEP, pose=(9.0, 9.0, 0.0))
            try:
                robot.feedback(timeout=30.0)
            except NotHeard as error:
                return error
            return None

        for robot, known in ((liars[0], True), (liars[1], True), (stranger, False)):
            error = eventually(lambda robot=robot: denied(robot))
            assert f"robot {robot.robot!r}: the mapper of map 'default' hears nothing" in str(error)
            assert "the name that of the certificate" in str(error)
            assert ("laser" in error.status.sources) is known


def test_a_robot_that_is_let_in_is_heard(site, mapper, eventually):
    before = mapper.status()["scans"]["integrated"]
    with site.robot("robot2", of="robot2") as robot:
        robot.wait_for_mapper()
        began = time.monotonic()
        count = 0
        while time.monotonic() < began + 3.5:  # longer than silence is borne
            robot.publish_scan([1.0] * 5, **SWEEP, pose=(1.0, 1.0, 0.0))
            count += 1
            assert robot.feedback(timeout=30.0).sources.keys() <= {"laser"}
            time.sleep(0.1)
        eventually(lambda: robot.feedback().sources["laser"].integrated == count)
        assert mapper.status()["robots"]["robot2"]["alive"]
    assert mapper.status()["scans"]["integrated"] == before + count


def test_a_certificate_that_expires_ends_its_connection(site, mapper, eventually):
    """One of robot2 that holds for some seconds: long enough to come in on a machine that is busy."""

    def alive():
        return mapper.status()["robots"].get("robot2", {"alive": False})["alive"]

    site.expiring("robot2", seconds=12)
    with site.robot("robot2", of="expiring"):
        eventually(alive)
        eventually(lambda: not alive())
    with pytest.raises(CannotConnect, match="with TLS each side needs a certificate"):
        site.robot("robot2", of="expiring")


def test_what_is_too_long_is_dropped_and_the_next_scan_is_not(site, mapper, eventually):
    key = f"{OWN}/robots/robot2/scan/laser"
    before = mapper.status()["scans"]["received"]
    with site.session("robot2") as session:
        publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
        eventually(lambda: publisher.matching_status.matching)
        publisher.put(bytes(5_000_000))
        publisher.put(b"short")
        eventually(lambda: mapper.status()["scans"]["received"] == before + 1)
        assert mapper.status()["robots"]["robot2"]["sources"]["laser"]["dropped"] == {"malformed": 1}


def test_strangers_truths_tokens_and_answers_are_not_seen(site, mapper, unchanged, looked):
    asked = []

    def answer(query):
        with query:
            asked.append(str(query.key_expr))
            query.reply(query.key_expr, b"{}")

    handler = zenoh.handlers.Callback(answer, indirect=False)
    keys = ["truth", "map", "status", "**", "alive/mapper/evil/0"]
    with site.session("robot2") as robot, site.session("viewer") as viewer:
        held = [who.declare_queryable(f"{OWN}/{key}", handler) for who in (robot, viewer) for key in keys]
        held += [who.liveliness().declare_token(f"{MAPPER}/0") for who in (robot, viewer)]
        held += [robot.liveliness().declare_token(f"{OWN}/alive/robot/robot1/0")]
        looked()
        with MapClient(zenoh_config=site.client("operator"), timeout=30.0) as client:
            assert client.fetch("map.npz") == mapper.get("map.npz")
        assert asked == []
        assert mapper.get("readyz") == b"ok"
        assert not mapper.status()["robots"]["robot1"]["alive"]
        quality = json.loads(mapper.get("quality"))
        assert quality.get("truth") is None
        assert len(held) == 13


def test_viewers_and_robots_read_and_nobody_asks_for_everything(site, mapper, unchanged):
    for name in ("viewer", "robot1", "operator"):
        with site.session(name) as session, MapClient(session=session, timeout=30.0) as client:
            assert client.fetch("map.npz") == mapper.get("map.npz")
            grid = client.get_map()
            assert client.status().revision == mapper.status()["revision"]
            assert client.cell(0.0, 0.0)
            assert client.quality()
            assert (
                client.raycast(0.0, 0.0).found.tolist()
                == grid.raycast(0.0, 0.0, [0.0], 1000.0).found.tolist()
            )
            assert client.check([(0.0, 0.0)]).tolist() == grid.check([(0.0, 0.0)]).tolist()
            assert np.array_equal(client.distance().values, grid.distance().values)
            assert np.array_equal(client.inflate(0.3).values, grid.inflate(0.3).values)
            for everything in ("ogm/**", f"{OWN}/**", f"{OWN}/*", "**", f"{OWN}/alive/**"):
                assert list(session.get(everything, timeout=30.0)) == []
            assert list(session.liveliness().get("ogm/**", timeout=30.0)) == []


def test_nobody_overhears_a_robot(site, mapper, eventually):
    heard = []
    handler = zenoh.handlers.Callback(heard.append, indirect=False)
    before = mapper.status()["scans"]["integrated"]
    with ExitStack() as opened:
        for name in ("robot2", "viewer", "operator"):
            session = opened.enter_context(site.session(name))
            for key in ("**", "ogm/**", f"{OWN}/robots/robot1/**"):
                opened.push(session.declare_subscriber(key, handler))
        robot = opened.enter_context(site.robot("robot1", of="robot1"))
        robot.wait_for_mapper()
        for _ in range(5):
            robot.publish_scan([1.0] * 5, **SWEEP, pose=(1.0, 1.0, 0.0))
        eventually(lambda: mapper.status()["scans"]["integrated"] == before + 5)
        assert heard == []


@pytest.mark.parametrize("name", ["viewer", "robot1", "operator"])
def test_who_reads_hears_what_changes_and_nobody_else_tells_it(site, mapper, unchanged, eventually, name):
    heard, key = [], f"{OWN}/updates"
    with site.session(name) as session, site.session("robot2") as liar:
        handler = zenoh.handlers.Callback(lambda sample: heard.append(sample.payload.to_bytes()))
        session.declare_subscriber(key, handler)

        def told():
            liar.put(key, b"a lie", congestion_control=zenoh.CongestionControl.BLOCK)
            return len(heard) > 2

        eventually(told)  # a mapper whose map does not change says so once a second
    assert b"a lie" not in heard
    updates = [update for payload in heard for update in decode_updates(payload)]
    assert {update.revision for update in updates} == {mapper.status()["revision"]}


def test_the_mapper_s_log_shows_denials_if_asked(site, ogm):
    """With the filter of docs/security.md."""
    shown = re.search(r"`RUST_LOG=(\S+)`", (ROOT / "docs/security.md").read_text())[1]
    endpoint = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/")
    config = site.mapper(endpoint=endpoint)
    mapper = ogm.start("mapper", "--http-port", 0, "--zenoh-config", config, RUST_LOG=shown)
    ogm.ready(mapper)
    with site.robot("robot1", of="robot2", endpoint=endpoint) as liar:
        liar.wait_for_mapper()
        liar.publish_pose(9.0, 9.0, 0.0)
        denied = r"is unauthorized to Put \(ingress\) on .*/robots/robot1/pose"
        mapper.line(rf".*CertCommonName\(robot2\).*{denied}")


def test_a_simulator_tells_the_truth_by_two_rules_more(site, ogm, eventually):
    """As docs/security.md says."""
    rules = re.search(r"```json5\n(.*?)```", (ROOT / "docs/security.md").read_text(), re.S)[1]

    def with_truth(text):
        policy = '{ rules: ["robot1", '
        assert policy in text
        return text.replace("    rules: [\n", f"    rules: [\n{rules}", 1).replace(
            policy, f'{policy}"asked", "truth", '
        )

    endpoint = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/")
    config = site.mapper(with_truth, endpoint)
    mapper = ogm.ready(ogm.start("mapper", "--http-port", 0, "--zenoh-config", config))
    ogm.start("simulate", "--zenoh-config", site.client("robot1", endpoint=endpoint))
    eventually(lambda: json.loads(mapper.get("quality")).get("truth"), timeout=60.0)


def test_a_viewer_records_by_two_rules_more(site, ogm, eventually):
    """As docs/security.md says: what robots had published before, what they publish, and the map."""
    rules = re.findall(r"```json5\n(.*?)```", (ROOT / "docs/security.md").read_text(), re.S)[1]

    def with_recorder(text):
        policy = '{ rules: ["read", "answer", "follow", "told"]'
        assert policy in text
        return text.replace("    rules: [\n", f"    rules: [\n{rules}", 1).replace(
            policy, '{ rules: ["read", "answer", "follow", "told", "hear", "heard"]'
        )

    endpoint = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/")
    config = site.mapper(with_recorder, endpoint)
    mapper = ogm.ready(ogm.start("mapper", "--http-port", 0, "--zenoh-config", config))
    with site.robot("robot1", of="robot1", endpoint=endpoint) as robot:
        robot.wait_for_mapper()
        for k in range(5):
            robot.publish_scan([1.0] * 5, **SWEEP, pose=(0.1 * k, 0.0, 0.0))
        eventually(lambda: mapper.status()["scans"]["integrated"] == 5)
        client = site.client("viewer", endpoint=endpoint)
        recorder = ogm.start("record", "-o", "a.mcap", "--zenoh-config", client)
        recorder.line("recording map default into a.mcap")
        robot.publish_scan([1.0] * 5, **SWEEP, pose=(0.6, 0.0, 0.0))

        def recorded():
            with McapReader(ogm.folder / "a.mcap") as recording, suppress(BadRecording):
                return len(list(recording))

        eventually(lambda: recorded() == 6, timeout=60.0)
    ended = recorder.stop()
    assert (ended.code, ended.warnings) == (0, "")
    assert "a.mcap: 6 scans and 0 poses of robot1" in ended.out


def test_a_replay_and_a_simulator_that_are_denied_say_so(site, mapper, module_ogm, lab_recording, unchanged):
    denied = ["--zenoh-config", site.client("robot2")]
    simulator = module_ogm.start("simulate", "--robot-prefix", "robot", *denied)
    replay = module_ogm.run("replay", lab_recording, "--robot", "robot1", "--speed", "max", *denied)
    said = "'robot1': the mapper of map 'default' hears nothing of the "
    assert f"never received; robot {said}" in replay.complaint(1)
    assert "does access control let them through, is the name that of the certificate" in replay.err
    simulator.complains(said)


def test_get_and_status_go_in_with_a_certificate(site, mapper, module_ogm, unchanged):
    viewer = site.client("viewer")
    (site.folder / "ogm.yaml").write_text(f"network: {{zenoh_config: {viewer}}}\n")
    for how in (
        {"flags": ["--zenoh-config", viewer]},
        {"flags": ["--config", site.folder / "ogm.yaml"]},
        {"environ": {"OGM_NETWORK__ZENOH_CONFIG": str(viewer)}},
        {
            "flags": [
                "--zenoh-config",
                site.client("viewer", endpoint="tls/127.0.0.1:1"),
                "--url",
                site.endpoint,
            ]
        },
    ):
        flags, environ = how.get("flags", []), how.get("environ", {})
        status = module_ogm.call("status", "--json", *flags, **environ)
        assert status.code == 0, status
        assert json.loads(status.out)["revision"] == mapper.status()["revision"]
        got = module_ogm.call("get", "map.npz", *flags, **environ)
        assert (got.code, got.out, got.err) == (0, "map.npz\n", "")
        assert (module_ogm.folder / "map.npz").read_bytes() == mapper.get("map.npz")
    other = module_ogm.call("status", "--zenoh-config", site.client("viewer", edit=no_certificate))
    assert "with TLS each side needs a certificate" in other.complaint(1)


def test_only_the_operator_resets(site, mapper):
    def reset(name):
        with MapClient(zenoh_config=site.client(name), timeout=30.0) as client:
            client.reset()

    before = mapper.status()["epoch"], mapper.get("map.npz")
    for name in ("robot1", "viewer"):
        with pytest.raises(NobodyAnswered, match="does access control not let this certificate ask") as error:
            reset(name)
        assert "within" not in str(error.value), "Zenoh says at once that nobody is asked"
        with MapClient(zenoh_config=site.client(name), timeout=30.0) as client:
            for write in (client.save_snapshot, client.restore_snapshot, client.delete_snapshot):
                with pytest.raises(NobodyAnswered, match="does access control not let"):
                    write("a")
            with pytest.raises(NobodyAnswered, match="does access control not let"):
                client.erase((-1, -1, 1, 1))
            with pytest.raises(NobodyAnswered, match="does access control not let"):
                client.forget("robot1")
            with pytest.raises(MapperError, match="stores no map"):
                client.snapshots()
    with MapClient(zenoh_config=site.client("operator"), timeout=30.0) as client:
        for write in (client.save_snapshot, client.restore_snapshot, client.delete_snapshot):
            with pytest.raises(MapperError, match="stores no map"):
                write("a")
        assert (mapper.status()["epoch"], mapper.get("map.npz")) == before
        with pytest.raises(MapperError, match="does not keep robots apart"):
            client.forget("robot1")
        assert client.erase((-50, -50, 50, 50)) > 1000
    assert (mapper.status()["epoch"], mapper.status()["map_info"]["width"]) == (before[0], 0)
    reset("operator")
    assert mapper.status()["epoch"] != before[0]
    assert mapper.status()["map_info"]["known_cells"] == 0


def test_a_robot_answers_from_its_own_cache_and_from_no_other(site, eventually):
    """With the mapper's file one gets what robot1 had put before one asked, and nothing in its name."""
    endpoint = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/")
    key, got = f"{OWN}/robots/robot1/pose", []
    cache = {
        "cache": zenoh.ext.CacheConfig(max_samples=100),
        "sample_miss_detection": zenoh.ext.MissDetectionConfig(sporadic_heartbeat=0.5),
        "publisher_detection": True,
    }
    with ExitStack() as opened:
        listener = opened.enter_context(zenoh.open(zenoh.Config.from_file(site.mapper(endpoint=endpoint))))
        robots = {
            name: zenoh.ext.declare_advanced_publisher(
                opened.enter_context(site.session(name, endpoint=endpoint)), key, **cache
            )
            for name in ("robot1", "robot2")
        }
        for name, publisher in robots.items():
            for k in range(5):
                publisher.put(f"{name}: {k}")
        subscriber = zenoh.ext.declare_advanced_subscriber(
            listener,
            f"{OWN}/robots/**",
            zenoh.handlers.Callback(lambda sample: got.append(sample.payload.to_string()), indirect=False),
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )
        eventually(lambda: len(got) >= 5)
        robots["robot1"].put("robot1: live")
        eventually(lambda: "robot1: live" in got)
        assert sorted(got) == sorted([*(f"robot1: {k}" for k in range(5)), "robot1: live"])
        subscriber.undeclare()


def of_router(text):
    """mapper.json5 for a router, as docs/security.md says: another mode, no `rx`."""
    assert 'mode: "peer"' in text
    return re.sub(r"\n *rx: .*", "", text.replace('mode: "peer"', 'mode: "router"'))


def test_shares_and_a_gateway_work_together_and_nobody_else_asks_or_answers_for_one(site, ogm, eventually):
    """As docs/security.md says: each is a client of the router with the certificate `mapper`."""
    endpoint, asked = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/"), []
    flags = ["--http-port", 0, "--cuts-x", 0, "--reach", 5, "--zenoh-config"]
    flags.append(site.client("mapper", endpoint=endpoint))

    def lie(query):
        with query:
            asked.append(str(query.key_expr))
            query.reply(query.key_expr, b"{}")

    with ExitStack() as opened:
        opened.enter_context(zenoh.open(zenoh.Config.from_file(site.mapper(of_router, endpoint))))
        strangers = [
            opened.enter_context(site.session(name, endpoint=endpoint))
            for name in ("robot2", "viewer", "operator")
        ]
        handler = zenoh.handlers.Callback(lie, indirect=False)
        keys = [f"{OWN}/shares/{share}/{name}" for share in (0, 1) for name in ("part", "status", "reset")]
        held = [who.declare_queryable(key, handler) for who in strangers for key in keys]
        for running in [
            *(ogm.start("mapper", "--share", share, *flags) for share in (0, 1)),
            ogm.start("gateway", *flags),
        ]:
            running.line(r"(status  |live map) http://")
        client = MapClient(session=strangers[1], timeout=30.0)
        robot = opened.enter_context(site.robot("robot1", of="robot1", endpoint=endpoint))
        robot.wait_for_mapper(30.0)
        for k in range(5):
            robot.publish_scan([1.0] * 5, **SWEEP, pose=(0.5 * k - 1.0, 0.0, 0.0))
        status = eventually(lambda: (told := client.status()).revision == 10 and told)
        assert (status.scans.integrated, status.complete) == (5, True)
        for who in strangers:
            for key in (*keys, f"{OWN}/shares/*/reset"):
                elsewhere = who.get(key, timeout=30.0, allowed_destination=zenoh.Locality.REMOTE)
                assert list(elsewhere) == []
        assert client.status().revision == 10
        assert client.get_map().known.any()
        assert len(held) == 18
        assert asked == []
        client.close()
        ended = running.stop()
    assert (ended.code, "the gateway has stopped" in ended.err) == (0, True)


def test_a_router_with_the_same_rules_stands_between(site, ogm, eventually):
    """As docs/security.md says; the mapper is a client with a certificate."""
    endpoint = resolve_listen("tcp/127.0.0.1:0").replace("tcp/", "tls/")
    with zenoh.open(zenoh.Config.from_file(site.mapper(of_router, endpoint))):
        config = site.client("mapper", endpoint=endpoint)
        mapper = ogm.ready(ogm.start("mapper", "--http-port", 0, "--zenoh-config", config))
        with (
            site.robot("robot1", of="robot1", endpoint=endpoint) as robot,
            site.robot("robot1", of="robot2", endpoint=endpoint) as liar,
        ):
            for publisher in (robot, liar):
                publisher.wait_for_mapper()
            for k in range(5):
                liar.publish_scan([9.0] * 5, **SWEEP, pose=(5.0, 5.0, 0.0))
                robot.publish_scan([1.0] * 5, **SWEEP, pose=(0.1 * k, 0.0, 0.0))
            eventually(lambda: mapper.status()["scans"]["integrated"] == 5)
            assert mapper.status()["scans"]["received"] == 5
            assert robot.feedback(timeout=30.0).sources["laser"].run == robot.run
        with MapClient(zenoh_config=site.client("viewer", endpoint=endpoint), timeout=30.0) as viewer:
            assert viewer.get_map().known.any()
            with pytest.raises(NobodyAnswered):
                viewer.reset()
        before = mapper.status()["epoch"]
        with MapClient(zenoh_config=site.client("operator", endpoint=endpoint), timeout=30.0) as operator:
            operator.reset()
        assert mapper.status()["epoch"] != before
        second = ogm.start("mapper", "--http-port", 0, "--zenoh-config", config)
        assert "another mapper of map 'default' is alive" in second.wait().complaint(1)
