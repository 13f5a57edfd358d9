"""Mutated files of every kind are read or refused in one line, in little memory; no other error comes out."""

import re
import subprocess
import sys
from pathlib import Path

MUTATED_FILES = Path(__file__).parents[1] / "mutated_files.py"


def test_mutated_files_are_read_or_refused():
    run = subprocess.run(
        [sys.executable, MUTATED_FILES, "10", "6"], capture_output=True, text=True, timeout=280, check=False
    )
    assert run.returncode == 0, run.stderr[-5000:]
    *kinds, memory = run.stdout.splitlines()
    assert len(kinds) == 24
    for line in kinds:
        assert re.fullmatch(r"[\w ,.]+: \d+ \w+(, \d+ \w+)*", line)
    assert " Bad" in run.stdout
    assert " read" in run.stdout
    assert int(re.fullmatch(r"memory: (\d+) MB", memory)[1]) < 1000
