"""``pip install ./quest`` gives quest alone: its project file agrees with that of slam-init, its wheel holds quest."""

import shutil
import subprocess
import sys
import tomllib
from zipfile import ZipFile

import pytest
from paths import ROOT

pytestmark = pytest.mark.process

QUEST = ROOT / "quest"


def project(folder):
    return tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))


def sources():
    return {
        path.relative_to(ROOT).as_posix()
        for path in QUEST.rglob("*.py")
        if not {"build", "__pycache__"} & {*path.parts}
    }


def test_the_project_files_agree():
    alone, whole = project(QUEST)["project"], project(ROOT)["project"]
    for name in ("version", "requires-python", "license", "authors"):
        assert alone[name] == whole[name]
    assert sorted(one.partition(">")[0] for one in alone["dependencies"]) == ["numba", "numpy"]
    assert set(alone["dependencies"]) <= set(whole["dependencies"])
    # "quest" on the index is another project.
    assert alone["name"] == "quest-relpose"


def test_all_folders_of_quest_are_packages_of_the_wheel():
    folders = {path.rpartition("/")[0].replace("/", ".") for path in sources() if path.endswith("__init__.py")}
    assert set(project(QUEST)["tool"]["setuptools"]["packages"]) == folders


def test_the_wheel_holds_quest_and_nothing_else(tmp_path):
    skipped = shutil.ignore_patterns("__pycache__", "build", "*.egg-info")
    shutil.copytree(QUEST, tmp_path / "quest", ignore=skipped)
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(tmp_path), str(tmp_path / "quest")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0 and "setuptools" in done.stderr and "No matching distribution" in done.stderr:
        pytest.skip("no index is reachable: pip cannot load setuptools to build a wheel")
    assert done.returncode == 0, done.stderr
    (wheel,) = tmp_path.glob("quest_relpose-*.whl")
    names = {name for name in ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert names == sources() | {"quest/py.typed"}
