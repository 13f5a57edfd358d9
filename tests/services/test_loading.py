"""How commands load what they need."""

import gc
import signal

import pytest

from ogm_services.runtime.loading import loading


def test_what_is_loaded_is_never_searched_for_garbage(monkeypatch):
    frozen = []
    monkeypatch.setattr(gc, "freeze", lambda: frozen.append(gc.isenabled()))
    with loading():
        assert not gc.isenabled()
        assert frozen == []
    assert gc.isenabled()
    assert frozen == [False]


def test_a_failure_while_loading_leaves_all_as_it_was(monkeypatch):
    monkeypatch.setattr(gc, "freeze", lambda: None)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(ImportError), loading():
        raise ImportError
    assert gc.isenabled()
    assert signal.getsignal(signal.SIGTERM) is before
