"""Compilation: the same results without it, no folder to write, and machine code that follows the source."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import quest.jit

pytestmark = pytest.mark.process

ESTIMATE = """
import sys
import numpy as np
import quest
assert "numba" not in sys.modules
rng = np.random.default_rng(0)
X = rng.uniform([-1, -1, 2], [1, 1, 6], (60, 3))
Y = X + [0.5, 0.1, 0.0] + 1e-3 * rng.normal(size=X.shape)
Y[:6] = rng.uniform([-1, -1, 2], [1, 1, 6], (6, 3))
pose = quest.estimate_relative_pose(X, Y, seed=1)
numba = sys.modules["numba"]
print(numba.config.DISABLE_JIT, pose.kind, pose.inliers.sum(), *pose.q_wxyz, *pose.t)
"""


def run(code: str, **options) -> str:
    """What a fresh interpreter prints."""
    return subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300, **options
    ).stdout


@pytest.fixture
def copied_package(tmp_path):
    """A copy of the package without machine code; a process whose folder is ``tmp_path`` imports it."""
    package = tmp_path / "quest"
    unused = shutil.ignore_patterns("__pycache__", "benchmarks")
    shutil.copytree(Path(quest.__file__).parent, package, ignore=unused)
    return package


def test_the_result_without_compilation_is_the_same():
    answers = []
    for disabled in ("0", "1"):
        environment = os.environ | {"NUMBA_DISABLE_JIT": disabled}
        done = subprocess.run(
            [sys.executable, "-W", "error::RuntimeWarning", "-c", ESTIMATE],
            env=environment, capture_output=True, text=True, check=True, timeout=300,
        )  # fmt: skip
        answers.append(done.stdout.split())
    assert [answer[0] for answer in answers] == ["0", "1"]
    assert answers[1][1:3] == answers[0][1:3]
    assert np.array(answers[1][3:], float) == pytest.approx(np.array(answers[0][3:], float), abs=1e-9)


def test_without_a_writable_folder_each_process_compiles(copied_package):
    module = copied_package / "algebra.py"
    no_folder = module.parent / "__pycache__"
    no_folder.touch()  # a file, so that no folder can be made there
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= dict.fromkeys(("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA"), str(no_folder / "nowhere"))
    code = "import numpy; from quest import algebra; algebra.tangents(numpy.eye(3)[2]); print(algebra.__file__)"
    assert run(code, cwd=copied_package.parent, env=environment).strip() == str(module)


def test_a_person_who_waits_gets_one_notice_that_loops_compile_and_nothing_where_machine_code_is_on_disk(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    code = "import numpy as np; from quest.algebra import tangents as of; of(np.eye(3)[2]); of(np.float32([0, 0, 1]))"
    command = [sys.executable, "-c", code]
    said = [subprocess.run(command, env=environment, capture_output=True, check=True).stderr for _ in range(2)]
    assert said[0].startswith(b"compiling") and [one.count(b"\n") for one in said] == [1, 0]


def test_an_edit_of_a_called_loop_renews_the_machine_code_of_its_callers(copied_package, tmp_path):
    """numba alone compares a function with its own file, and keeps the machine code where a called file changes."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "machine_code")}
    code = (
        "import numpy as np; from quest.robust.kernels.refinement import refine;"
        "X = np.random.default_rng(0).uniform(-1, 1, (20, 3)) + [0, 0, 4];"
        "m, n = (one / np.linalg.norm(one, axis=1, keepdims=True) for one in (X, X + [1, 0, 0]));"
        "R, t = np.eye(3), np.array([0.8, 0.6, 0.0]);"
        "refine(m, n, np.ones(20, bool), R, t, 1.0, 1); print(np.trace(R))"
    )
    before = run(code, cwd=copied_package.parent, env=environment)
    module = copied_package / "algebra.py"
    source = module.read_text()
    halved = source.replace(
        "angle = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)", "w0 *= 0.5\n    angle = np.sqrt(w0 * w0 + w1 * w1 + w2 * w2)"
    )
    assert halved != source
    module.write_text(halved)
    assert run(code, cwd=copied_package.parent, env=environment) != before


def test_portable_machine_code_serves_a_processor_without_its_own_and_may_be_called_by_a_loop(tmp_path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    code = (
        "import numpy as np; from quest import algebra, jit;"
        "t = np.array([0.6, 0.0, 0.8]); print(*algebra.tangents(t));"
        "caller = jit.numba.njit(lambda t: algebra.tangents(t)[5]);"
        "print(caller(t), sum(algebra.tangents.stats.cache_hits.values()))"
    )
    portable = run(code, env=environment | {"NUMBA_CPU_NAME": "generic"}).split()
    kept = sorted(tmp_path.rglob("*.code"))
    assert run(code, env=environment).split() == [*portable[:-1], "1"]
    assert portable[-1] == "0" and portable[5] == portable[6]
    assert sorted(tmp_path.rglob("*.code")) == kept


def test_numba_compiles_the_loops_of_others_as_before_after_one_of_ours_that_fails():
    from numba.core import codegen, errors

    before = dict(vars(codegen.CPUCodeLibrary))
    with pytest.raises(errors.TypingError):
        quest.jit.compiled(lambda x: x.nothing)(1.0)
    assert vars(codegen.CPUCodeLibrary) == before
