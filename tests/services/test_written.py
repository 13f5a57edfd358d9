"""What keeps a command from writing is one line that names the flag, the path and the reason."""

import errno
from pathlib import Path

import pytest

from ogm_core.errors import BadInput
from ogm_services.results.written import written


def test_the_line_names_flag_path_and_reason(tmp_path):
    with pytest.raises(BadInput) as caught, written(tmp_path / "a", "--out"):
        (tmp_path / "nowhere" / "a").write_bytes(b"")
    assert str(caught.value) == f"--out {tmp_path}/a: cannot be written: No such file or directory"
    with pytest.raises(BadInput, match=r"^-o a: cannot be written: odd$"), written(Path("a"), "-o"):
        raise OSError("odd")


def test_what_is_no_trouble_with_a_file_stays_what_it_is(tmp_path):
    with written(tmp_path / "a", "--out"):
        (tmp_path / "a").write_bytes(b"1")
    assert (tmp_path / "a").read_bytes() == b"1"
    with pytest.raises(ValueError, match="mine"), written(tmp_path, "--out"):
        raise ValueError("mine")
    with pytest.raises(BrokenPipeError), written(tmp_path, "--out"):
        raise BrokenPipeError(errno.EPIPE, "Broken pipe")
