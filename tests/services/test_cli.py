import math
import os
import re
import signal
import subprocess
import sys
import types
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ogm_core.errors import BadRecording, LimitReached
from ogm_core.lattice import Region
from ogm_services.cli import app
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.commands.log_readers import ReadAs
from ogm_services.commands.simulator_options import SimulatorOptions

MAP_FLAGS = (
    "--preset --resolution --sensor-model --cell-model --traversal --p-occ --p-free --p-prior "
    "--alpha --l-min --l-max --reach "
    "--clear-range --cells --bounds --outside --half-life --free-below --sensor"
)
NETWORK_FLAGS = "--map --listen --connect --zenoh-config"
HTTP_FLAGS = "--http-host --http-port --http-hosts --root-path --http-token-file"
MAPPER_FLAGS = "--threads --data --start-map --start-confidence --separate-robots"
SERVICE_FLAGS = "--log-level --log-format --print-config"
LOG_FLAGS = (
    "--range-max --robot --odometry --scan-topic --cloud-topic --z-band --bins --pose-topic --fixed-frame "
    "--mount --scan-delay"
)
FLAGS = {
    "demo": f"--world --start --duration --out --robot --config {MAP_FLAGS} {NETWORK_FLAGS} {HTTP_FLAGS} "
    f"{SERVICE_FLAGS}",
    "mapper": f"--out --robot --config {MAP_FLAGS} {MAPPER_FLAGS} {NETWORK_FLAGS} {HTTP_FLAGS} "
    f"--share --cuts-x --cuts-y {SERVICE_FLAGS}",
    "gateway": f"--config --cuts-x --cuts-y --gather-timeout {MAP_FLAGS} {NETWORK_FLAGS} {HTTP_FLAGS} "
    f"{SERVICE_FLAGS}",
    "simulate": "--robots --robot-prefix --robot-radius --rate --seed --world --start --beams --fov "
    f"--range-max --noise --out --scans --connect-timeout --config {NETWORK_FLAGS} {SERVICE_FLAGS}",
    "record": f"--out -o --repair --config {NETWORK_FLAGS} {SERVICE_FLAGS}",
    "replay": f"--speed --config {LOG_FLAGS} {NETWORK_FLAGS} {SERVICE_FLAGS}",
    "build": "--threads --workers --dask --each --out --hold-out --world --figure --config --print-config "
    f"{MAP_FLAGS} {LOG_FLAGS}",
    "merge": "--out -o",
    "info": "--json",
    "get": "--out -o --at --url --map --zenoh-config --config",
    "status": "--json --watch --url --map --zenoh-config --config",
    "snapshot list": "--json --url --map --zenoh-config --config",
    **{
        f"snapshot {write}": "--json --token-file --url --map --zenoh-config --config"
        for write in ("save", "restore", "delete")
    },
    "erase": "--region --polygon --json --token-file --url --map --zenoh-config --config",
    "forget": "--json --token-file --url --map --zenoh-config --config",
    "foxglove": f"--host --port --layout --url --map --zenoh-config --config {SERVICE_FLAGS}",
    "ros2": "--list --json --dds --interface --zenoh --domain --scan-topic --cloud-topic --z-band --bins "
    "--pose-topic --mount --scan-delay --tf-hold --map-frame --odom-frame --publish-map "
    f"--publish-probabilities --robot --sensor --config {NETWORK_FLAGS} {SERVICE_FLAGS}",
}


@pytest.fixture(autouse=True)
def environment(monkeypatch):
    for name in [name for name in os.environ if name.startswith("OGM_")]:
        monkeypatch.delenv(name)


@pytest.fixture
def ogm():
    def ogm(*args):
        return CliRunner().invoke(app, [str(arg) for arg in args], prog_name="ogm", catch_exceptions=False)

    return ogm


@dataclass
class Stub:
    """Stands in for a service's function: keeps its arguments, or raises."""

    raises: BaseException | None = None
    args: tuple = ()
    options: dict = field(default_factory=dict)

    def __call__(self, *args, **options):
        self.args, self.options = args, options
        if self.raises:
            raise self.raises


@pytest.fixture
def stub(monkeypatch):
    def stub(module, function, raises=None):
        made = Stub(raises)
        monkeypatch.setitem(sys.modules, module, types.SimpleNamespace(**{function: made, "record": made}))
        return made

    return stub


@pytest.mark.parametrize("command", FLAGS)
def test_help_lists_every_flag_and_nothing_else(ogm, command):
    result = ogm(*command.split(), "-h")
    assert result.exit_code == 0
    shown = re.findall(r"^│[ *]*(--[a-z-]+)(?: +(-[a-z]) )?", result.stdout, re.MULTILINE)
    assert {flag for flags in shown for flag in flags if flag} == {*FLAGS[command].split(), "--help", "-h"}


def test_help_lists_commands_by_what_they_work_on(ogm):
    shown = re.findall(r"^(?:╭─ (.+?) ─+╮|│ ([a-z]\w+) )", ogm("--help").stdout, re.MULTILINE)
    assert " ".join(panel or command for panel, command in shown) == (
        "Options Live: mapper, robots and recorder demo mapper gateway simulate replay ros2 record "
        "A running mapper and its map get status erase forget foxglove snapshot "
        "Recordings and stored maps, without network build quality compare merge info repair"
    )


def test_help_states_defaults_and_units(ogm):
    text = " ".join(ogm("mapper", "--help").stdout.replace("│", " ").split())
    assert "Size of a cell (default: 0.05)" in text
    assert "METRES" in text
    assert "int16|float64" in text
    assert "(default: 8000)" in text


def test_version(ogm):
    result = ogm("--version")
    assert result.exit_code == 0
    assert result.stdout.startswith("ogm ")
    assert result.stdout[4].isdigit()


def test_help_loads_neither_kernels_nor_network():
    code = (
        "import sys, runpy; sys.argv = ['ogm', '--help']\n"
        "try: runpy.run_module('ogm_services', run_name='__main__')\n"
        "except SystemExit as end: assert end.code == 0, end.code\n"
        "print(sorted({'numba', 'zenoh', 'fastapi', 'uvicorn', 'httpx'} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "Usage: ogm" in done.stdout
    assert done.stderr.strip() == "[]"


def one_line(result, code):
    """The complaint of a command that ended with `code`."""
    assert result.exit_code == code
    assert result.stdout == ""
    assert result.stderr.startswith("ogm: ")
    assert result.stderr.endswith("\n")
    assert result.stderr.count("\n") == 1
    return result.stderr


@pytest.mark.parametrize(
    ("args", "text"),
    [
        ("mappr", "mappr"),
        ("mapper --resolutio 1", "--resolution"),
        ("mapper --alpha -1", "map.alpha: input should be greater than or equal to 0, got '-1' (--alpha)"),
        ("mapper --bounds 0,0,1,0.98", "19.6 cells"),
        ("mapper --config /nowhere/ogm.yaml", "/nowhere/ogm.yaml: cannot be read"),
        ("demo --duration 0", "--duration"),
        ("demo --http-port 70000", "(--http-port)"),
        ("simulate --rate 0", "rate: 0.001 scans a second or more"),
        ("simulate --rate 1e-300", "rate: 0.001 scans a second or more"),
        ("mapper --resolution 1e300", "map.resolution"),
        ("simulate --robots 0", "robots: at least 1"),
        ("simulate --robots many", "--robots"),
        ("simulate --robot-prefix r/", "robot-prefix 'r/1': a name is"),
        ("simulate --robots 10 --robot-prefix " + "x" * 63, "xx10': a name is 1 to 64"),
        ("simulate --robot-radius 0", "robot-radius: more than 0 and at most 100 m are needed, got 0"),
        ("simulate --robot-radius nan", "robot-radius: more than 0 and at most 100 m are needed, got nan"),
        ("simulate --connect-timeout -1", "connect-timeout: 0 s or more"),
        ("simulate --connect-timeout nan", "connect-timeout: 0 s or more"),
        ("simulate --fov 361", "at most 360 degrees are needed, got 361"),
        ("simulate --out run.jsonl", "--scans"),
        (
            "simulate --out run.json --scans 1",
            "--out run.json: a name that ends in .jsonl, .jsonl.gz, .mcap is",
        ),
        ("simulate --start 1", "--start: two numbers X,Y in metres are needed, got '1'"),
        ("simulate --start 1,2,3", "--start: two numbers X,Y"),
        ("simulate --start 1,inf", "--start: two numbers X,Y"),
        ("demo --start here", "--start: two numbers X,Y in metres are needed, got 'here'"),
        ("simulate --map a/b", "map_name 'a/b'"),
        ("record", "-o FILE.mcap is needed"),
        ("record -o a.mcap --repair a.mcap", "--repair, -o: give one of them"),
        ("record -o a.jsonl", "-o a.jsonl: recordings of robots are MCAP files: end it in .mcap"),
        ("record --repair none.mcap", "none.mcap: cannot be repaired (No such file or directory)"),
        ("ros2", "where are the robots? --dds"),
        ("ros2 --list", "where are the robots? --dds"),
        ("ros2 --zenoh tcp/a:1 --json", "--json: it goes with --list"),
        ("ros2 --zenoh tcp/a:1 --interface lo", "--interface: it is DDS's"),
        ("ros2 --dds --domain x", "--domain: whole numbers such as 0 or 0,1 are needed, got 'x'"),
        ("ros2 --dds --domain 0,233", "--domain: 0 to 232 are needed, got 233"),
        ("ros2 --dds --mount 1,2,3", "--mount: it goes with --pose-topic"),
        ("ros2 --dds --pose-topic /p --mount 1,2", "--mount: three finite numbers X,Y,THETA"),
        ("ros2 --dds --pose-topic p", "'p': names of topics begin with /"),
        ("ros2 --dds --bins 10", "--cloud-topic is needed"),
        ("ros2 --dds --cloud-topic /c --bins 0", "bins: 1 to 36000 are needed, got 0"),
        (
            "ros2 --dds --cloud-topic /c --z-band 1",
            "--z-band: two numbers MIN,MAX in metres are needed, got '1'",
        ),
        ("ros2 --dds --cloud-topic /c --z-band 1,0", "z band: finite z_min < z_max is needed"),
        ("ros2 --dds --tf-hold -1", "--tf-hold: 0 to 60 s are needed, got -1"),
        ("ros2 --dds --scan-delay nan", "--scan-delay: -10 to 10 s, got nan"),
        ("ros2 --dds --sensor r/s:range_max=3", "sensors.range_max: that is for the mapper"),
        (
            "ros2 --dds --publish-map map",
            "--publish-map: a topic's full name such as /ogm/map is needed, got 'map'",
        ),
        ("ros2 --dds --publish-map /a --publish-probabilities /a", "two topics are needed"),
        (
            "ros2 --dds --publish-map /a --publish-probabilities /a_updates",
            "would be /a, /a_updates, /a_updates",
        ),
        (
            "ros2 --dds --map-frame /map",
            "--map-frame: a frame's name without / before it is needed, got '/map'",
        ),
        ("ros2 --dds --odom-frame=", "--odom-frame: a frame's name without / before it is needed, got ''"),
        ("ros2 --dds --robot r:origin=1", "robots.origin: three finite numbers X,Y,THETA"),
        (
            "ros2 --dds --robot r:radius=1",
            "robots.radius: that is for the mapper: ogm mapper --robot 'r:radius=1'",
        ),
        (
            "mapper --robot r:origin=1,2,3",
            "robots.origin: that is for ogm ros2: ogm ros2 --robot 'r:origin=1,2,3'",
        ),
        ("demo --robot r:radius=1,name=b", "robots.name: that is for ogm ros2"),
        ("demo --robot r:radius=0", "robots.radius: input should be greater than 0, got '0'"),
        ("replay x.log --robot r:radius=1", "robots.radius: that is for the mapper"),
        ("replay x.log --robot a --robot b", "--robot: the log's one robot gets one name, not a and b"),
        ("replay x.log --speed fast", "--speed: a number above 0, or max, is needed, got 'fast'"),
        ("replay x.log --speed 0", "--speed"),
        ("replay x.log --speed inf", "--speed"),
        ("replay", "LOG"),
        ("build x.log", "--out"),
        ("build x.log --out d --hold-out 1", "--hold-out: 2 or more"),
        ("build x.log --out d --mount 1,2", "--mount: three finite numbers X,Y,THETA"),
        ("build x.log --out d --scan-delay nan", "--scan-delay: -10 to 10 s, got nan"),
        ("build x.log --out d --scan-topic scan", "'scan': names of topics begin with /"),
        ("build x.log --out d --pose-topic /p --fixed-frame map", "--fixed-frame: it is for poses of tf"),
        ("build x.log --out d --scan-delay 1", "x.log: --scan-topic, --cloud-topic, --pose-topic"),
        (
            "build . --out d --bins 9",
            "--z-band, --bins: they are for clouds, so --cloud-topic",
        ),
        ("build . --out d --odometry", ".: --odometry is for CARMEN logs; --fixed-frame odom"),
        ("get", "NAME"),
        ("get map.gif -o x --url http://127.0.0.1:9", "map.gif"),
        ("status --url nowhere", "nowhere"),
        ("get status --at monday", "--at monday: only maps are saved"),
        ("get map.png?at=a --at b --url http://127.0.0.1:9", "--at says b, and NAME at=a"),
        ("snapshot lst", "lst"),
        ("snapshot save", "NAME"),
        ("snapshot save a/b --url http://127.0.0.1:9", "name 'a/b': a name is 1 to 64"),
        ("snapshot save a --url http://127.0.0.1:9 --token-file /nowhere", "/nowhere: cannot be read"),
        ("snapshot save a --token-file /nowhere", "--token-file /nowhere: the token is for HTTP alone"),
        ("snapshot list --url nowhere", "nowhere"),
        ("erase --url http://127.0.0.1:9", "--region or --polygon: one of them is needed"),
        ("erase --region=0,0,1,1 --polygon 0,0,1,0,1,1", "--region or --polygon: one of them is needed"),
        ("erase --region 0,0,1", "--region: four numbers XMIN,YMIN,XMAX,YMAX are needed"),
        ("erase --polygon 0,0,1,0,1", "--polygon: X1,Y1,X2,Y2,... is needed, got 5 numbers"),
        ("erase --polygon 0,0,1,0,1,1_0", "--polygon: a number is needed, got '1_0'"),
        (
            "erase --region=0,0,1,1 --token-file /nowhere",
            "--token-file /nowhere: the token is for HTTP alone",
        ),
        ("forget", "ROBOT"),
        ("forget a/b --url http://127.0.0.1:9", "robot 'a/b': a name is 1 to 64"),
        ("mapper --separate-robots", "separate_robots: the cells of cell model log_odds do not add up"),
        (
            "mapper --separate-robots --cell-model rate --half-life 60",
            "mapper.separate_robots: with map.half_life cells forget whose beams they have counted",
        ),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(ogm, args, text):
    assert text in one_line(ogm(*args.split()), 2)


@pytest.mark.parametrize(
    ("args", "flag"),
    [
        ("build x.log --out", "--out"),
        ("build x.log --out d --figure", "--figure"),
        ("demo --out", "--out"),
        ("mapper --out", "--out"),
        ("simulate --scans 1 --out", "--out"),
        ("record -o", "-o"),
        ("get status -o", "-o"),
        ("merge a.npz b.npz -o", "-o"),
        ("compare a.npz b.npz --picture", "--picture"),
        ("quality x.log --figure", "--figure"),
        ("foxglove --layout", "--layout"),
        ("repair d --out", "--out"),
    ],
)
def test_an_empty_path_is_not_the_working_folder(ogm, tmp_path, monkeypatch, args, flag):
    monkeypatch.chdir(tmp_path)
    said = one_line(ogm(*args.split(), ""), 2)
    assert f"{flag}': a path is needed, got ''" in said
    assert list(tmp_path.iterdir()) == []


def test_nor_is_an_empty_folder_of_a_stored_map(ogm):
    assert "mapper.data: a path is needed, got '' (--data)" in one_line(ogm("mapper", "--data", ""), 2)


def test_without_a_command_it_shows_its_help(ogm):
    result = ogm()
    assert result.exit_code == 2
    assert "Usage: ogm" in result.stdout
    assert result.stderr == "ogm: a command is needed (see ogm --help)\n"


def test_an_unknown_name_in_the_environment_is_refused(ogm, monkeypatch):
    monkeypatch.setenv("OGM_MAP__RESOLUTON", "1")
    assert "OGM_MAP__RESOLUTON: unknown setting" in one_line(ogm("mapper"), 2)


def test_the_mapper_gets_the_settings_of_all_sources(ogm, stub, monkeypatch, tmp_path):
    run = stub("ogm_services.mapper.service", "run_mapper")
    config = tmp_path / "ogm.yaml"
    config.write_text("map: {preset: lab, alpha: 0.3, p_occ: 0.8}\nhttp: {port: 9000}\n")
    monkeypatch.setenv("OGM_MAP__P_OCC", "0.9")
    flags = "--l-min -4 --bounds -5,-5,5,5 --http-host 0.0.0.0 --map hall --listen tcp/a:1,tcp/b:2"
    result = ogm("mapper", "--config", config, "--out", tmp_path / "out", *flags.split())
    assert result.exit_code == 0
    assert result.output == ""
    settings, out = run.args
    assert out == tmp_path / "out"
    assert settings.map.model_dump(include={"preset", "alpha", "p_occ", "l_min", "cells"}) == {
        "preset": "lab",
        "alpha": 0.3,
        "p_occ": 0.9,
        "l_min": -4.0,
        "cells": "float64",
    }
    assert settings.map.bounds == Region(-5.0, -5.0, 5.0, 5.0)
    assert (settings.http.host, settings.http.port) == ("0.0.0.0", 9000)
    assert settings.network.map_name == "hall"
    assert settings.network.listen == ("tcp/a:1", "tcp/b:2")


def test_demo_uses_the_ordinary_defaults_in_the_labs_world(ogm, stub):
    run = stub("ogm_services.commands.demo", "run_demo")
    assert ogm("demo", "--duration", "2.5", "--http-port", "0").exit_code == 0
    (settings,) = run.args
    assert run.options == {"world": "lab", "start": None, "duration": 2.5, "out": None}
    assert (settings.map.preset, settings.map.resolution, settings.http.port) == (None, 0.05, 0)


def test_simulate_takes_degrees_and_passes_on_radians(ogm, stub):
    run = stub("ogm_services.commands.simulator", "run_simulator")
    flags = "--robots 3 --rate 5 --seed 4 --world office --beams 90 --fov 180 --range-max 12 --noise 0.01"
    assert ogm("simulate", *flags.split(), "--connect", "tcp/a:1").exit_code == 0
    network, options = run.args
    assert network.connect == ("tcp/a:1",)
    assert options == SimulatorOptions("office", 3, 5.0, 4, 90, math.pi, 12.0, 0.01, None)
    assert (options.names, options.connect_timeout) == (["robot1", "robot2", "robot3"], math.inf)


def test_simulated_robots_have_names_of_their_own(ogm, stub):
    run = stub("ogm_services.commands.simulator", "run_simulator")
    flags = ("--robots", 2, "--robot-prefix", "cart-", "--connect-timeout", 3, "--robot-radius", 0.3)
    assert ogm("simulate", *flags).exit_code == 0
    options = run.args[1]
    assert options.names == ["cart-1", "cart-2"]
    assert (options.connect_timeout, options.robot_radius) == (3.0, 0.3)


@pytest.mark.parametrize(("workers", "warned"), [(1, False), (2, False), (3, True)])
def test_more_workers_than_cores_are_warned_of(ogm, stub, monkeypatch, workers, warned):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {4, 6})
    run = stub("ogm_services.commands.build", "run_build")
    said = ogm("build", "a.jsonl", "--out", "maps", "--workers", workers)
    assert (said.exit_code, run.args[0].workers) == (0, workers)
    line = "ogm: --workers 3: more than this process has cores (2) take longer, and more memory\n"
    assert said.stderr == line * warned


def test_shells_complete_commands_and_flags(ogm):
    program = [sys.executable, "-m", "ogm_services"]
    for words, found in {"ogm si": ["simulate"], "ogm replay --sp": ["--speed"]}.items():
        environ = {"_OGM_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
        done = subprocess.run(
            program, env={**os.environ, **environ}, capture_output=True, text=True, timeout=300, check=True
        )
        assert done.stdout.split() == found


@pytest.mark.parametrize("text", ["-1.5,2", "-1.5, 2.0"])
def test_simulate_and_demo_take_a_start(ogm, stub, text):
    simulate = stub("ogm_services.commands.simulator", "run_simulator")
    assert ogm("simulate", "--world", "map.yaml", "--start", text).exit_code == 0
    assert simulate.args[1] == SimulatorOptions("map.yaml", start=(-1.5, 2.0))
    demo = stub("ogm_services.commands.demo", "run_demo")
    assert ogm("demo", "--world", "map.yaml", "--start", text).exit_code == 0
    assert demo.options["start"] == (-1.5, 2.0)


def test_simulate_without_flags(ogm, stub):
    run = stub("ogm_services.commands.simulator", "run_simulator")
    assert ogm("simulate").exit_code == 0
    assert run.args[1] == SimulatorOptions()


def test_record_says_which_extra_is_missing_before_anything_else(ogm, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mcap", None)
    text = "MCAP recordings need the package mcap: pip install 'zenoh-ogm[ros2]'"
    assert text in one_line(ogm("record", "-o", tmp_path / "a.mcap", "--connect", "tcp/127.0.0.1:1"), 2)
    assert text in one_line(ogm("simulate", "--out", tmp_path / "a.mcap", "--scans", 1), 2)
    assert list(tmp_path.iterdir()) == []


def test_simulate_records_without_network(ogm, stub):
    record = stub("ogm_services.commands.simulator", "run_simulator")
    assert ogm("simulate", "--out", "run.jsonl.gz", "--scans", "10", "--fov", "360").exit_code == 0
    options, out = record.args
    assert (options.scans, options.fov, out) == (10, math.tau, Path("run.jsonl.gz"))


@pytest.mark.parametrize(("text", "speed"), [("1", 1.0), ("2.5", 2.5), ("max", None)])
def test_replay(ogm, stub, text, speed):
    run = stub("ogm_services.commands.replay", "run_replay")
    flags = f"--speed {text} --range-max 50 --robot r2 --odometry --map m"
    result = ogm("replay", "a.log", *flags.split())
    assert result.exit_code == 0
    log, settings = run.args
    assert (log, settings.network.map_name) == (Path("a.log"), "m")
    assert run.options == {"speed": speed, "read_as": ReadAs(50.0, "r2", odometry=True)}


def test_replay_runs_as_recorded_unless_told_otherwise(ogm, stub):
    run = stub("ogm_services.commands.replay", "run_replay")
    ogm("replay", "a.log")
    assert run.options == {"speed": 1.0, "read_as": ReadAs()}


def test_quality(ogm, stub):
    run = stub("ogm_services.commands.quality", "run_quality")
    flags = "--every 5 --blocks --hold-out 4 --range-max 79 --alpha 0.2 --models sector,dda --json"
    assert ogm("quality", "a.log", "b.log", *flags.split()).exit_code == 0
    logs, variants, held = run.args
    assert logs == [Path("a.log"), Path("b.log")]
    assert {name: (of.map.sensor_model, of.map.traversal, of.map.alpha) for name, of in variants.items()} == {
        "sector": ("sector", "bresenham", 0.2),
        "dda": ("beam", "dda", 0.2),
    }
    assert held == HeldScans(4, every=5, blocks=True)
    assert run.options == {"read_as": ReadAs(79.0), "as_json": True, "figure": None}
    assert ogm("quality", "a.log", "--traversal", "dda").exit_code == 0
    assert (list(run.args[1]), run.args[2]) == (["dda"], HeldScans(10))


def test_build(ogm, stub):
    run = stub("ogm_services.commands.build", "run_build")
    flags = "--out maps --hold-out 5 --range-max 8 --preset lab"
    assert ogm("build", "a.jsonl", *flags.split()).exit_code == 0
    (asked,) = run.args
    assert asked.settings.map.preset == "lab"
    plain = BuildRequest([Path("a.jsonl")], Path("maps"), asked.settings, ReadAs(8.0), HeldScans(5))
    assert asked == plain
    robots = ("--robot", "a*:radius=0.3", "--robot", "r2", "--robot", "b:origin=1,2,3")
    assert ogm("build", "a.jsonl", "--out", "maps", *robots).exit_code == 0
    (asked,) = run.args
    assert asked.read_as.robot == "r2"
    assert [(robot.match, robot.radius) for robot in asked.settings.robots] == [("a*", 0.3), ("b", None)]
    assert ogm("build", "a.jsonl", *["--out", "maps", "--world", "lab", "--figure", "a.pdf"]).exit_code == 0
    assert (run.args[0].world, run.args[0].figure) == ("lab", Path("a.pdf"))


def test_build_each(ogm, stub):
    run = stub("ogm_services.commands.build_each", "run_each")
    flags = "--out maps --each --workers 3 --world lab"
    assert ogm("build", "a.jsonl", "b.log", *flags.split()).exit_code == 0
    (asked,) = run.args
    logs = [Path("a.jsonl"), Path("b.log")]
    assert asked == BuildRequest(logs, Path("maps"), asked.settings, world="lab", workers=3)
    assert ogm("build", "a.jsonl", *["--out", "maps", "--each", "--dask", "tcp://a:1"]).exit_code == 0
    assert (run.args[0].workers, run.args[0].dask) == (1, "tcp://a:1")
    for flags, said in (
        ("--each --figure a.png", "--figure draws one map: leave it out with --each"),
        ("--workers 2 --dask tcp://a:1", "--workers: a Dask cluster has the workers that it has"),
        ("--workers 100000", "Invalid value for '--workers': "),
    ):
        assert said in one_line(ogm("build", "a.log", "--out", "x", *flags.split()), 2)


def test_bad_input_found_later_is_exit_code_2(ogm, stub):
    stub("ogm_services.commands.build", "run_build", BadRecording("a.log: holds no scan"))
    assert one_line(ogm("build", "a.log", "--out", "x"), 2) == "ogm: a.log: holds no scan\n"


def test_a_failure_at_run_time_is_exit_code_1(ogm, stub):
    stub("ogm_services.mapper.service", "run_mapper", LimitReached("too\nlarge"))
    assert one_line(ogm("mapper"), 1) == "ogm: too large\n"


def test_a_bug_keeps_its_traceback(ogm, stub):
    stub("ogm_services.commands.build", "run_build", ZeroDivisionError("bug"))
    with pytest.raises(ZeroDivisionError, match="bug"):
        ogm("build", "a.log", "--out", "x")


SLEEPER = """
import sys, threading, types
def run(*args, **options):
    print("ready", flush=True)
    threading.Event().wait()
sys.modules[{module!r}] = types.SimpleNamespace({function}=run)
sys.argv = {argv!r}
from ogm_services.cli import main
main()
"""
INTERRUPTIONS = [
    ("ogm_services.mapper.service", "run_mapper", "mapper", signal.SIGINT, 0),
    ("ogm_services.mapper.service", "run_mapper", "mapper", signal.SIGTERM, 0),
    ("ogm_services.commands.demo", "run_demo", "demo", signal.SIGINT, 0),
    ("ogm_services.commands.replay", "run_replay", "replay a.log", signal.SIGINT, 130),
    ("ogm_services.commands.build", "run_build", "build a.log --out x", signal.SIGINT, 130),
]


@pytest.mark.parametrize(("module", "function", "command", "stop", "code"), INTERRUPTIONS)
def test_interrupted(module, function, command, stop, code):
    program = SLEEPER.format(module=module, function=function, argv=["ogm", *command.split()])
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(stop)
        _, complaint = process.communicate(timeout=300)
    assert (process.returncode, complaint) == (code, "")
