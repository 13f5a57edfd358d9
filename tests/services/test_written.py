"""What keeps a command from writing is one line that names the flag, the path and the reason."""

import errno
from pathlib import Path

import pytest
from typer.testing import CliRunner

from ogm_core.errors import BadInput, DiskFull
from ogm_services.cli import app
from ogm_services.results.written import written


def test_the_line_names_flag_path_and_reason(tmp_path):
    with pytest.raises(BadInput) as caught, written(tmp_path / "a", "--out"):
        (tmp_path / "nowhere" / "a").write_bytes(b"")
    assert str(caught.value) == f"--out {tmp_path}/a: cannot be written: No such file or directory"
    with pytest.raises(BadInput, match=r"^-o a: cannot be written: odd$"), written(Path("a"), "-o"):
        raise OSError("odd")


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_disk_that_is_full_is_nobody_s_bad_input(number):
    with pytest.raises(DiskFull) as caught, written(Path("maps"), "--out"):
        raise OSError(number, "no room")
    assert str(caught.value) == "--out maps: cannot be written: no room"
    assert not isinstance(caught.value, BadInput)


def test_what_is_no_trouble_with_a_file_stays_what_it_is(tmp_path):
    with written(tmp_path / "a", "--out"):
        (tmp_path / "a").write_bytes(b"1")
    assert (tmp_path / "a").read_bytes() == b"1"
    with pytest.raises(ValueError, match="mine"), written(tmp_path, "--out"):
        raise ValueError("mine")
    with pytest.raises(BrokenPipeError), written(tmp_path, "--out"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")


def test_commands_that_run_out_of_room_fail_and_leave_what_was_there(tmp_path, request):
    """Recording and building: a line on stderr, exit code 1, the older files as they were."""
    log, out = tmp_path / "log.jsonl", tmp_path / "built"

    def ogm(*arguments):
        return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)

    simulate = ("simulate", "--world", "lab", "--seed", "1", "--out", log)
    assert ogm(*simulate, "--scans", "2").exit_code == 0
    assert ogm("build", log, "--out", out, "--resolution", "0.5").exit_code == 0
    before = {path: path.read_bytes() for path in (log, *out.iterdir())}
    assert len(before) == 6
    request.getfixturevalue("disk_full")
    for command in ((*simulate, "--scans", "3"), ("build", log, "--out", out, "--resolution", "0.4")):
        done = ogm(*command)
        assert (done.exit_code, done.stdout) == (1, "")
        assert "--out" in done.stderr.splitlines()[-1]
        assert "No space left on device" in done.stderr.splitlines()[-1]
    assert {path: path.read_bytes() for path in (log, *out.iterdir())} == before
