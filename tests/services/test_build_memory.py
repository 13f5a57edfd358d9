"""A map is judged by the scans kept in memory, or by its log, read again: the figures are the same."""

import json

import pytest

from ogm_services.commands import build, log_readers, mapped_logs
from ogm_services.commands.build_request import BuildRequest
from ogm_services.commands.held_scans import HeldScans
from ogm_services.settings.sources import load_settings
from rough_log import write_rough_log


@pytest.fixture
def opened(monkeypatch):
    """The logs that builds have opened, one entry for each time."""
    paths = []

    class Reader(log_readers.RecordingReader):
        def __enter__(self):
            paths.append(self.path)
            return super().__enter__()

    monkeypatch.setattr(log_readers, "RecordingReader", Reader)
    return paths


@pytest.mark.parametrize("hold_out", [None, 3])
def test_a_log_is_read_again_only_if_its_scans_are_too_many(tmp_path, monkeypatch, opened, hold_out):
    log = tmp_path / "log.jsonl"
    write_rough_log(log)
    # Every scan that starts or ends outside is refused: what the map took differs from what was placed.
    flags = {"map": {"bounds": "0,-10,10,10", "outside": "drop"}}
    settings = load_settings(config=None, flags=flags, environ={})

    def quality(room):
        monkeypatch.setattr(mapped_logs, "MAX_KEPT", room)
        opened.clear()
        build.run_build(BuildRequest([log], tmp_path, settings, held=HeldScans(hold_out)))
        return json.loads((tmp_path / "quality.json").read_text()), len(opened)

    expected, times = quality(0)
    assert times == 2
    assert 0.5 < expected["consistency"]["hits"] < 1.0
    assert quality(100_000) == (expected, 2)
    assert quality(10_000_000) == (expected, 1)
