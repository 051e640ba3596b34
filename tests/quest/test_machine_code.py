"""Machine code on disk: found where an installation has it, never half a file, one file for many processes at once."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from quest import machine_code

pytestmark = pytest.mark.process

ROTATION = (
    "import sys, numpy as np; from quest import algebra; R = np.eye(3);"
    "algebra.turn(R, 0.1, *algebra.tangents(R[2])[:2]); print(*R.ravel(), 'scipy.linalg' in sys.modules)"
)


def start(folder: Path) -> subprocess.Popen[str]:
    """A process that needs a compiled loop."""
    return subprocess.Popen(
        [sys.executable, "-c", ROTATION],
        env=os.environ | {"NUMBA_CACHE_DIR": str(folder)},
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


def answer(process: subprocess.Popen[str]) -> list[str]:
    """What a process prints."""
    printed = process.communicate(timeout=300)[0].split()
    assert process.returncode == 0
    return printed


@pytest.fixture(scope="module")
def compiled_folder(tmp_path_factory):
    """A folder that two processes have filled at once, and what they printed."""
    folder = tmp_path_factory.mktemp("machine_code")
    return folder, [answer(process) for process in [start(folder) for _ in range(2)]]


def test_processes_that_compile_at_once_agree_and_leave_one_file_for_each_loop(compiled_folder):
    folder, answers = compiled_folder
    # The last line says whether the process compiled: the later one may find all loops compiled.
    assert answers[0][:-1] == answers[1][:-1]
    names = [path.name for path in (folder / "quest").iterdir()]
    assert len(names) == len({name.split("-")[0] for name in names}) > 0
    assert all(name.endswith(".code") and not name.startswith(".") for name in names)


def test_a_later_process_loads_the_machine_code_without_what_the_compiler_needs(compiled_folder):
    folder, answers = compiled_folder
    changed = {path: path.stat().st_mtime_ns for path in (folder / "quest").iterdir()}
    printed = answer(start(folder))
    assert printed[:-1] == answers[0][:-1]
    assert printed[-1] == "False"
    assert changed == {path: path.stat().st_mtime_ns for path in (folder / "quest").iterdir()}


def test_damaged_machine_code_is_made_again(compiled_folder):
    folder, answers = compiled_folder
    (loop,) = (folder / "quest").glob("*.turn-*")
    whole = loop.read_bytes()
    loop.write_bytes(whole[: len(whole) // 2])
    assert answer(start(folder))[:-1] == answers[0][:-1]
    assert loop.stat().st_size == pytest.approx(len(whole), rel=0.05)


def test_a_folder_that_is_no_folder_is_passed_over(tmp_path):
    blocked, free = tmp_path / "a file", tmp_path / "cache"
    blocked.touch()
    machine_code.write((blocked, free), "loop.code", b"bytes")
    assert machine_code.read((blocked, free), "loop.code") == b"bytes"
    assert [path.name for path in free.iterdir()] == ["loop.code"]
    machine_code.write((blocked,), "loop.code", b"bytes")
    assert machine_code.read((blocked,), "loop.code") is None


def test_a_named_folder_is_the_only_one(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert machine_code.folders_of(Path("kernels")) == (tmp_path / "quest",)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path))
    first, second = machine_code.folders_of(Path("kernels"))
    assert first == Path("kernels/__pycache__")
    assert second.name == "quest"


def test_a_user_without_a_home_has_no_folder(monkeypatch):
    """As in a container: no HOME, and a number that the system has no user for."""

    def no_home(path):
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(Path, "expanduser", no_home)
    assert machine_code.folders_of(Path("kernels")) == (Path("kernels/__pycache__"),)
