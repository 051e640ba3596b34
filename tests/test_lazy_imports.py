"""Heavy libraries are loaded when they are first needed, not before."""

import subprocess
import sys
import tomllib

import pytest
from paths import ROOT

pytestmark = pytest.mark.process

RULES = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["ruff"]["lint"]["flake8-tidy-imports"]
HEAVY = tuple(RULES["banned-module-level-imports"])


def loaded_by(code, names=HEAVY):
    """Which of some modules, by default the heavy libraries, a fresh interpreter has loaded after some code."""
    report = f"import sys; {code}; print(' '.join(n for n in {names} if n in sys.modules))"
    done = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True, cwd=ROOT, check=True)
    return done.stdout.split()


@pytest.mark.parametrize("module", ["slam_init.cli", "slam_init.initializer", "quest", "sequences_synth"])
def test_a_fresh_interpreter_loads_nothing_heavy(module):
    assert loaded_by(f"import {module}") == []


def test_an_initializer_without_a_map_loads_neither_maps_nor_their_adjustment():
    assert (
        loaded_by("import slam_init.initializer", ("slam_init.bundle", "slam_init.mapping", "slam_init.window")) == []
    )


def test_estimation_loads_neither_opencv_nor_another_solver():
    code = (
        "import numpy as np, quest; rng = np.random.default_rng(0);"
        "X = rng.uniform((-1, -1, 2), (1, 1, 4), (60, 3)); Y = X + (0.3, 0.1, 0.0);"
        "assert quest.estimate_relative_pose(X, Y, threshold_rad=1e-3, seed=0);"
        "assert 'poselib' not in sys.modules"
    )
    assert set(loaded_by(code)) <= {"scipy"}  # numba looks for it
