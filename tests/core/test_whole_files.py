"""Files are there whole or not at all, and what is no file stays what it is."""

import errno
import os
import stat
import threading
from pathlib import Path

import pytest

from ogm_core import whole_files
from ogm_core.whole_files import check_file, whole_file, write_files


def test_a_file_takes_its_name_when_it_is_complete(tmp_path):
    path = tmp_path / "map"
    path.write_bytes(b"before")
    with whole_file(path) as file:
        file.write(b"after")
        file.flush()
        assert path.read_bytes() == b"before"
    assert path.read_bytes() == b"after"
    assert list(tmp_path.iterdir()) == [path]


def fail_midway(path):
    with whole_file(path) as file:
        file.write(b"aft")
        raise RuntimeError("midway")


def test_a_failure_on_the_way_leaves_what_was_there(tmp_path):
    old, new = tmp_path / "old", tmp_path / "new"
    old.write_bytes(b"before")
    for path in (old, new):
        with pytest.raises(RuntimeError, match="midway"):
            fail_midway(path)
    assert list(tmp_path.iterdir()) == [old]
    assert old.read_bytes() == b"before"


def test_it_is_on_disk_before_it_takes_its_name(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(os, "fsync", lambda fd: seen.append(str(Path(f"/proc/self/fd/{fd}").readlink())))
    replace = Path.replace

    def noted(part, target):
        seen.append((str(part), target.name, part.read_bytes()))
        return replace(part, target)

    monkeypatch.setattr(Path, "replace", noted)
    write_files({tmp_path / "a": b"1", tmp_path / "b": b"2"})
    flushed = [entry for entry in seen if isinstance(entry, str)]
    renamed = [entry for entry in seen if not isinstance(entry, str)]
    assert [entry[1:] for entry in renamed] == [("a", b"1"), ("b", b"2")]
    assert {entry[0] for entry in renamed} == set(flushed)
    assert {entry[0] for entry in renamed} == set(seen[:2])  # both, before the first takes its name


def test_files_that_belong_together_are_all_written_or_none(tmp_path):
    (tmp_path / "a").write_bytes(b"before")
    (tmp_path / "b").mkdir()
    for contents in (
        {tmp_path / "a": b"1", tmp_path / "b": b"2"},
        {tmp_path / "a": b"1", tmp_path / "nowhere" / "c": b"2"},
    ):
        with pytest.raises(OSError):
            write_files(contents)
        assert (tmp_path / "a").read_bytes() == b"before"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_a_disk_that_is_full_leaves_what_was_there(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    (tmp_path / "a").write_bytes(b"before")
    with pytest.raises(OSError, match="No space left"):
        write_files({tmp_path / "a": b"1", tmp_path / "b": b"2"})
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a", b"before")]


def test_modes_are_those_of_any_file_and_are_kept(tmp_path):
    plain, mine = tmp_path / "plain", tmp_path / "mine"
    plain.write_bytes(b"")
    mine.write_bytes(b"")
    mine.chmod(0o640)
    write_files({tmp_path / "new": b"1", mine: b"1"})
    assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == stat.S_IMODE(plain.stat().st_mode)
    assert stat.S_IMODE(mine.stat().st_mode) == 0o640


def test_a_link_goes_on_to_lead_to_the_file(tmp_path):
    (tmp_path / "there").mkdir()
    target, link = tmp_path / "there" / "map", tmp_path / "link"
    link.symlink_to(target)
    for content in (b"1", b"2"):
        write_files({link: content})
        assert link.is_symlink()
        assert target.read_bytes() == content


def test_a_fifo_is_written_and_stays_one(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    read = []
    reader = threading.Thread(target=lambda: read.append(fifo.read_bytes()), daemon=True)
    reader.start()
    write_files({fifo: b"map"})
    reader.join(10.0)
    assert read == [b"map"]
    assert stat.S_ISFIFO(fifo.stat().st_mode)
    assert list(tmp_path.iterdir()) == [fifo]


def test_a_fifo_that_is_looked_at_has_not_ended_for_its_reader(tmp_path):
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    check_file(fifo)  # nobody reads it yet: whoever writes will wait for that
    with os.fdopen(os.open(fifo, os.O_RDONLY | os.O_NONBLOCK), "rb") as reader:
        check_file(fifo)
        write_files({fifo: b"map"})
        assert reader.read() == b"map"


def test_links_in_a_circle_are_told_as_what_they_are(tmp_path):
    (tmp_path / "a").symlink_to(tmp_path / "a")
    for refused in (lambda: check_file(tmp_path / "a"), lambda: write_files({tmp_path / "a": b""})):
        with pytest.raises(OSError, match="Too many levels of symbolic links"):
            refused()


def test_a_file_goes_only_when_the_others_are_on_disk(tmp_path):
    (tmp_path / "figures").write_bytes(b"of before")
    (tmp_path / "b").mkdir()
    with pytest.raises(IsADirectoryError):
        write_files({tmp_path / "a": b"1", tmp_path / "b": b"2"}, without=[tmp_path / "figures"])
    assert (tmp_path / "figures").read_bytes() == b"of before"
    write_files({tmp_path / "a": b"1"}, without=[tmp_path / "figures"])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
    write_files({tmp_path / "a": b"2"}, without=[tmp_path / "figures"])
    assert (tmp_path / "a").read_bytes() == b"2"


def test_devices_stay_what_they_are(tmp_path):
    for path in (Path("/dev/null"), tmp_path / "nothing"):
        if not path.exists():
            path.symlink_to("/dev/null")
        check_file(path)
        write_files({path: b"map"})
        assert stat.S_ISCHR(path.stat().st_mode)
    assert (tmp_path / "nothing").is_symlink()


def test_what_a_process_has_open_is_written_and_not_replaced(tmp_path):
    path = tmp_path / "out"
    with path.open("wb") as out:
        before = path.stat().st_ino
        for name in (f"/dev/fd/{out.fileno()}", f"/proc/self/fd/{out.fileno()}"):
            write_files({Path(name): name.encode()})
            assert path.read_bytes() == name.encode()
    assert path.stat().st_ino == before
    assert whole_files._STREAMS.fullmatch("/dev/stdout")
    assert not whole_files._STREAMS.fullmatch("/dev/shm/map.png")


def test_what_cannot_be_written_is_found_out_before(tmp_path):
    (tmp_path / "file").write_bytes(b"kept")
    check_file(tmp_path / "file")
    check_file(tmp_path / "new")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("file", b"kept")]
    for path, error in (
        (tmp_path, IsADirectoryError),
        (tmp_path / "nowhere" / "a", FileNotFoundError),
        (tmp_path / "file" / "a", NotADirectoryError),
    ):
        with pytest.raises(error):
            check_file(path)
        with pytest.raises(error):
            write_files({path: b""})
    assert len(list(tmp_path.iterdir())) == 1
