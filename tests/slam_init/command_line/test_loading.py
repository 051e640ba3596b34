"""The libraries of a run: all of them are there afterwards, and nothing else has changed."""

from __future__ import annotations

import gc
import subprocess
import sys
from contextlib import nullcontext

import pytest
from paths import ROOT

from slam_init.cli.loading import load_libraries

pytestmark = pytest.mark.process


@pytest.mark.parametrize("pictures", [False, True])
def test_what_a_run_needs_is_loaded_at_once(pictures):
    report = (
        "import os, sys; from slam_init.cli.loading import load_libraries\n"
        f"load_libraries(pictures={pictures})\n"
        "print(*(name in sys.modules for name in ('rerun', 'numba', 'slam_init.runner', 'matplotlib.figure')))\n"
        "print(os.environ['RERUN_ANALYTICS'])"
    )
    done = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True, cwd=ROOT, check=True)
    assert done.stdout.split() == ["True", "True", "True", str(pictures), "false"]


@pytest.mark.parametrize("collecting", [False, True])
def test_the_collector_is_as_before_whatever_happens(monkeypatch, collecting):
    before = gc.isenabled()
    try:
        gc.enable() if collecting else gc.disable()
        for error in (None, ImportError, KeyboardInterrupt):

            def load(pictures, error=error):
                assert not gc.isenabled()
                if error is not None:
                    raise error

            monkeypatch.setattr("slam_init.cli.loading._load", load)
            with pytest.raises(KeyboardInterrupt) if error is KeyboardInterrupt else nullcontext():
                load_libraries(pictures=False)
            assert gc.isenabled() is collecting
    finally:
        gc.enable() if before else gc.disable()
        gc.unfreeze()
