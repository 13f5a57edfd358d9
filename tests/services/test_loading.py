"""How commands load what they need."""

import gc
import signal
import subprocess
import sys

import pytest

from ogm_services.loading import loading


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


def test_kernels_are_loaded_without_linear_algebra_that_others_may_load_later():
    program = """if True:
        import sys
        from ogm_services.loading import load_numba
        load_numba()
        from ogm_services.mapper.service import warm_up
        from ogm_services.settings import Settings
        warm_up(Settings().grid_settings())
        print("numba" in sys.modules, "scipy.linalg" in sys.modules)
        import scipy.linalg
        load_numba()
        print(scipy.linalg.det([[2.0, 1.0], [1.0, 1.0]]), sys.modules["scipy.linalg"] is scipy.linalg)
    """
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60.0)
    assert (run.stdout.split(), run.stderr) == (["True", "False", "1.0", "True"], "")
