"""What a wheel ships: the three packages, nothing of the laboratory, and nothing that needs the extra ``test``."""

import json
import subprocess
import sys
from importlib.metadata import distributions
from pathlib import PurePosixPath

import pytest
from paths import ROOT

pytestmark = pytest.mark.process

PACKAGES = ("quest", "sequences_synth", "slam_init")
#: Packages that the extra ``test`` installs and a user need not have.
TEST_PACKAGES = ("pytest", "hypothesis", "numpydoc", "pandas", "jinja2", "pebble", "evo", "pycolmap", "distributed",
                 "h5py", "rosbags", "av", "xdist", "mcap", "mcap_ros2")  # fmt: skip
#: A wheel of Python files only: more than this is a picture, a table or machine code that slipped in.
LARGEST_MB = 4.0


@pytest.fixture(scope="module")
def shipped():
    """The files of the installed distribution that pip wrote from the wheel: path -> bytes."""
    # Building leaves metadata without a RECORD beside the packages.
    installed = next((one for one in distributions(name="slam-init") if one.read_text("RECORD")), None)
    if installed is None:
        pytest.skip("slam-init is not installed")
    origin = json.loads(installed.read_text("direct_url.json") or "{}")
    if origin.get("dir_info", {}).get("editable"):
        pytest.skip("an editable installation has no files of its own")
    files = {PurePosixPath(str(file)): file.size or 0 for file in installed.files or ()}
    return {file: size for file, size in files.items() if not {"__pycache__", ".."} & set(file.parts)}


def test_a_wheel_holds_the_packages_and_no_other_file(shipped):
    own = {file for file in shipped if not file.parts[0].endswith(".dist-info")}
    assert {file.parts[0] for file in own} == set(PACKAGES)
    assert not [file for file in own if {"benchmarks", "examples", "tests", "measured"} & set(file.parts)]
    source = {
        PurePosixPath(file.relative_to(ROOT).as_posix())
        for package in PACKAGES
        for file in (ROOT / package).rglob("*.py")
    }
    assert {file for file in own if file.suffix == ".py"} == source
    others = {file.suffix for file in own} - {".py"}
    assert others <= {".typed", ".pyi", "", ".html", ".json"}


def test_a_wheel_is_small(shipped):
    assert sum(shipped.values()) < LARGEST_MB * 1e6


def test_each_module_is_imported_without_the_packages_of_the_tests():
    code = f"""
import importlib, pkgutil, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {TEST_PACKAGES!r}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Absent())
for package in {PACKAGES!r}:
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
