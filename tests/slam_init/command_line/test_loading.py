"""The libraries of a run: all of them are there afterwards, and nothing else has changed."""

from __future__ import annotations

import subprocess
import sys

import pytest
from paths import ROOT

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
