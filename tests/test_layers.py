"""The layers of the project: who may import whom, and what is loaded when."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HEAVY = ("cv2", "gtsam", "rerun", "scipy", "tqdm", "matplotlib", "evo", "pycolmap", "loky", "distributed")


def imported(path):
    """(top-level package, whether at import time) of every import in a file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    inside = {
        id(inner)
        for outer in ast.walk(tree)
        if isinstance(outer, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or is_typing_only(outer)
        for inner in ast.walk(outer)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = [node.module]
        else:
            continue
        for name in names:
            yield name.split(".")[0], id(node) not in inside


def is_typing_only(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def sources(package):
    found = sorted((ROOT / package).rglob("*.py"))
    assert found, f"no sources in {package}"
    return found


def users(package, library):
    """Files of a package, relative to it, that import a library anywhere."""
    return {
        path.relative_to(ROOT / package).as_posix()
        for path in sources(package)
        if library in {name for name, _ in imported(path)}
    }


@pytest.mark.parametrize("library", ["slam_init", "sequences_synth"])
def test_quest_knows_nothing_of_its_users(library):
    assert users("quest", library) == set()


@pytest.mark.parametrize("library", [*HEAVY, "poselib"])
def test_quest_stands_on_numpy_alone_and_only_its_benchmarks_know_its_rivals(library):
    assert {name for name in users("quest", library) if not name.startswith("benchmarks/")} == set()


@pytest.mark.parametrize("library", ["slam_init", "quest", "gtsam", "rerun"])
def test_the_synthetic_world_knows_nothing_of_what_is_tested_on_it(library):
    assert users("sequences_synth", library) == set()


def test_gtsam_has_one_module_and_the_graph_reader():
    examples = {name for name in users("slam_init", "gtsam") if name.startswith("examples/")}
    assert users("slam_init", "gtsam") - examples == {"bundle_graph.py", "export.py"}
    tree = ast.parse((ROOT / "slam_init/export.py").read_text(encoding="utf-8"))
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    assert [f.name for f in functions if "import gtsam" in ast.unparse(f)] == ["load_graph"]


def test_rerun_is_imported_by_the_recording_alone():
    found = users("slam_init", "rerun")
    assert found
    assert all(name.startswith("recording") for name in found)


def test_the_synthetic_world_is_read_like_any_other_data_set():
    product = {name for name in users("slam_init", "sequences_synth") if not name.startswith("benchmarks/")}
    assert product <= {"datasets/synth.py", "datasets/points.py", "cli.py"}


@pytest.mark.parametrize("library", ["evo", "pycolmap", "poselib", "matplotlib", "pytest", "hypothesis"])
def test_what_judges_the_product_is_no_part_of_it(library):
    outside = {name for name in users("slam_init", library) if not name.startswith("benchmarks/")}
    # PoseLib is also one of the methods that can be asked for by name.
    assert outside == ({"methods/poselib.py"} if library == "poselib" else set())


@pytest.mark.parametrize("package", ["quest", "slam_init"])
def test_heavy_libraries_are_imported_where_they_are_needed(package):
    early = {
        f"{path.relative_to(ROOT)}: {name}"
        for path in sources(package)
        for name, at_import_time in imported(path)
        if at_import_time and name in HEAVY
    }
    assert early == set()


def loaded_by(code):
    """Which heavy libraries a fresh interpreter has loaded after some code."""
    report = f"import sys; {code}; print(' '.join(n for n in {HEAVY} if n in sys.modules))"
    done = subprocess.run([sys.executable, "-c", report], capture_output=True, text=True, cwd=ROOT, check=True)
    return done.stdout.split()


@pytest.mark.parametrize("module", ["slam_init.cli", "slam_init.pipeline", "quest"])
def test_a_fresh_interpreter_loads_nothing_heavy(module):
    assert loaded_by(f"import {module}") == []


def test_estimation_loads_neither_opencv_nor_another_solver():
    code = (
        "import numpy as np, quest; rng = np.random.default_rng(0);"
        "X = rng.uniform((-1, -1, 2), (1, 1, 4), (60, 3)); Y = X + (0.3, 0.1, 0.0);"
        "assert quest.estimate_relative_pose(X, Y, threshold_rad=1e-3, seed=0);"
        "assert 'poselib' not in sys.modules"
    )
    assert set(loaded_by(code)) <= {"scipy"}  # numba looks for it
