"""How commands load what they need."""

import gc
import signal
import subprocess
import sys

import pytest
import typer

from ogm_services.runtime.loading import loading
from ogm_services.runtime.signals import running_service


def test_what_is_loaded_is_never_searched_for_garbage(monkeypatch):
    frozen = []
    monkeypatch.setattr(gc, "freeze", lambda: frozen.append(gc.isenabled()))
    with loading():
        assert not gc.isenabled()
        assert frozen == []
    assert gc.isenabled()
    assert frozen == [False]


@pytest.fixture(autouse=True)
def handlers():
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def test_a_failure_while_loading_leaves_all_as_it_was(monkeypatch):
    monkeypatch.setattr(gc, "freeze", lambda: None)
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(ImportError), loading():
        raise ImportError
    assert gc.isenabled()
    assert signal.getsignal(signal.SIGTERM) is before


def write_modules(folder, monkeypatch, swallow):
    """Modules of which the first sends a signal and imports the second."""
    first = "import signal\nsignal.raise_signal(signal.SIGTERM)\n"
    first += "try:\n    import ogm_second\n" + swallow
    (folder / "ogm_first.py").write_text(first)
    (folder / "ogm_second.py").write_text("")
    monkeypatch.syspath_prepend(folder)


@pytest.mark.parametrize(
    "swallow",
    [
        "finally:\n    pass\n",
        "except BaseException:\n    pass\nimport ogm_second\n",
        "except BaseException:\n    raise ImportError('made of it')\n",
    ],
)
def test_a_signal_waits_for_no_more_than_the_module_at_hand(tmp_path, monkeypatch, swallow):
    monkeypatch.setattr(gc, "freeze", lambda: None)
    write_modules(tmp_path, monkeypatch, swallow)
    finders = list(sys.meta_path)

    def load():
        with running_service(interrupted=7), loading():
            import ogm_first  # noqa: F401

    with pytest.raises(typer.Exit) as end:
        load()
    assert end.value.exit_code == 7
    assert not {"ogm_first", "ogm_second"} & set(sys.modules)
    assert sys.meta_path == finders


def test_a_build_loads_neither_zenoh_nor_what_only_judging_by_held_out_scans_needs():
    program = "import sys, ogm_services.commands.build; print([name in sys.modules for name in sys.argv[1:]])"
    names = ["ogm_services.commands.batch.work", "zenoh", "scipy.optimize"]
    done = subprocess.run([sys.executable, "-c", program, *names], capture_output=True, text=True, check=True)
    assert done.stdout == "[True, False, False]\n"
