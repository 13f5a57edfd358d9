"""`ogm record`: the file holds what the mapper had, whatever ends it, and gives the mapper's map."""

import json
import re
import resource
import signal

import pytest

from ogm_core.errors import BadRecording
from ogm_services.ros2.mcap_reader import McapReader


def recorder(ogm, endpoint, file="live.mcap"):
    """A recorder that hears what is published from now on."""
    command = ogm.start("record", "--connect", endpoint, "-o", file, "--log-level", "warning")
    command.line(rf"recording map default into {file}: Ctrl-C ends it")
    return command


def scans_in(path):
    """Seqs of the scans that can be read, by robot, and whether the file is whole."""
    seqs = {}
    with McapReader(path) as reader:
        try:
            for each in reader:
                if hasattr(each, "sensor"):
                    seqs.setdefault(each.robot, []).append(each.message.seq)
        except BadRecording:  # as long as there is no scan
            pass
        return seqs, not reader.doubt


def has(path, robots, scans):
    """Whether so many scans of each of so many robots can be read."""
    found = scans_in(path)[0] if path.exists() else {}
    return list(map(len, found.values())) == [scans] * robots


def test_a_recording_gives_the_live_map_built_and_replayed(ogm, lab_recording, assert_equal_maps, eventually):
    """Of one robot value for value; it ends with the map, and with exit code 0."""
    mapper = ogm.ready(ogm.mapper())
    command = recorder(ogm, mapper.endpoint)
    assert ogm.run("replay", lab_recording, "--connect", mapper.endpoint, "--speed", "max").code == 0
    live = mapper.map()
    eventually(lambda: has(ogm.folder / "live.mcap", 1, 220))
    ended = command.stop(signal.SIGINT)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.endswith("live.mcap: 220 scans and 220 poses of robot1\n")
    assert ogm.call("build", "live.mcap", "--out", "built").code == 0
    assert_equal_maps(ogm.map("built/map.npz"), live)
    again = ogm.ready(ogm.mapper())
    replayed = ogm.run("replay", "live.mcap", "--connect", again.endpoint, "--speed", "max")
    assert (replayed.code, replayed.out) == (0, "live.mcap: 220 scans sent, 220 integrated\n")
    assert_equal_maps(again.map(), live)
    found = json.loads(ogm.call("info", "live.mcap", "--json").out)
    topics = {topic["name"]: topic["messages"] for topic in found["topics"]}
    assert (topics["/map"], topics["/robot1/laser"], topics["/tf"]) == (1, 220, 440)
    refused = ogm.run("record", "--connect", mapper.endpoint, "-o", "live.mcap")
    assert "live.mcap: is there already" in refused.complaint(2)


def test_of_several_robots_it_holds_the_scans_that_the_mapper_had(ogm, eventually):
    """The mapper ends first: its map is not to be had, and that is said."""
    mapper = ogm.ready(ogm.mapper())
    command = ogm.start("record", "--connect", mapper.endpoint, "-o", "a.mcap")
    command.line("recording map default")
    flags = "--connect", mapper.endpoint, "--robots", 3, "--scans", 40, "--rate", 40, "--seed", 1
    assert ogm.run("simulate", *flags).code == 0
    eventually(lambda: mapper.status()["scans"]["integrated"] == 120)
    eventually(lambda: has(ogm.folder / "a.mcap", 3, 40))
    assert mapper.command.stop().code == 0
    ended = command.stop(signal.SIGINT)
    assert ended.code == 0
    assert "no mapper serves map default, so the recording ends without one" in ended.err
    assert ended.out.endswith("a.mcap: 120 scans and 120 poses of robot1, robot2, robot3\n")
    seqs, whole = scans_in(ogm.folder / "a.mcap")
    assert whole
    assert seqs == {f"robot{n}": list(range(40)) for n in (1, 2, 3)}


@pytest.mark.usefixtures("listener")
def test_what_is_killed_has_recorded_up_to_then_and_is_repaired(ogm, endpoint, eventually):
    robots = ogm.start("simulate", "--connect", endpoint, "--robots", 2, "--seed", 1)
    for n in range(2):
        path = ogm.folder / f"killed{n}.mcap"
        command = recorder(ogm, endpoint, path.name)

        def enough(path=path, n=n):
            found = scans_in(path)[0]
            return len(found) == 2 and min(map(len, found.values())) > 10 * (n + 1) and found

        seen = eventually(enough)
        command.process.kill()
        command.process.wait()
        seqs, whole = scans_in(path)
        assert not whole
        for robot, found in seqs.items():
            assert found[: len(seen[robot])] == seen[robot]
            assert found == list(range(found[0], found[0] + len(found)))
        said = ogm.call("record", "--repair", path.name)
        count = sum(map(len, seqs.values()))
        assert said.code == 0
        assert f"({count} scans and " in said.out
        assert scans_in(path) == (seqs, True)
    assert robots.stop().code == 0


@pytest.mark.usefixtures("listener")
def test_a_full_disk_ends_it_in_one_line(ogm, endpoint):
    command = recorder(ogm, endpoint)
    resource.prlimit(command.process.pid, resource.RLIMIT_FSIZE, (350_000, resource.RLIM_INFINITY))
    robots = ogm.start("simulate", "--connect", endpoint, "--robots", 2, "--seed", 1, "--rate", 100)
    ended = command.wait()
    assert robots.stop().code == 0
    assert ended.code == 1
    assert ended.warnings.startswith("ogm: live.mcap: cannot be written any more: File too large; ")
    assert ended.warnings.count("\n") == 1
    seqs, whole = scans_in(ogm.folder / "live.mcap")
    assert not whole
    assert len(seqs["robot1"]) > 20
    told = int(
        re.search(r"; at least (\d+) scans and \d+ poses of robot1, robot2 can be read;", ended.warnings)[1]
    )
    assert 40 < told <= sum(map(len, seqs.values()))
    assert f"({sum(map(len, seqs.values()))} scans and" in ogm.call("record", "--repair", "live.mcap").out


def test_it_waits_for_a_network_and_ends_well_without_one(ogm, endpoint):
    command = ogm.start("record", "--connect", endpoint, "-o", "a.mcap")
    command.complains("waiting for")
    ended = command.stop(signal.SIGINT)
    assert (ended.code, ended.out) == (0, "a.mcap is not made: neither a mapper nor a router was there\n")
    assert not (ogm.folder / "a.mcap").exists()


def test_who_records_another_map_is_told_that_nothing_came(ogm, endpoint):
    """As with a wrong --map; so that nobody takes an empty file home."""
    command = ogm.start("record", "--listen", endpoint, "--map", "floor2", "-o", "a.mcap")
    command.line("recording map floor2")
    assert ogm.run("simulate", "--connect", endpoint, "--scans", 2).code == 0
    ended = command.stop(signal.SIGINT)
    assert (ended.code, ended.out.splitlines()[-1]) == (
        0,
        "a.mcap: 0 scans and 0 poses of 0 robots: no robot published to map floor2; "
        "robots and recorder need the same --map and address",
    )
    assert ogm.run("build", "a.mcap", "--out", "a").complaint(2) == "ogm: a.mcap: holds no message\n"


@pytest.mark.usefixtures("listener")
def test_a_file_that_is_removed_ends_it_and_one_that_is_moved_does_not(ogm, endpoint, eventually):
    command = recorder(ogm, endpoint)
    (ogm.folder / "live.mcap").rename(ogm.folder / "moved.mcap")
    assert ogm.run("simulate", "--connect", endpoint, "--scans", 3).code == 0
    eventually(lambda: has(ogm.folder / "moved.mcap", 1, 3))
    (ogm.folder / "moved.mcap").unlink()
    ended = command.wait()
    assert ended.code == 1
    assert ended.warnings == (
        "ogm: live.mcap: was removed while it was written, and 3 scans and 3 poses of robot1 with it; "
        "record anew\n"
    )
