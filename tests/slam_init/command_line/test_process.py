"""The command line as a process of its own: start-up, closed and full streams."""

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.process


def test_help_loads_no_heavy_library():
    code = (
        "import sys; from slam_init.cli import main; main(['--help']);"
        "print(sorted({m.split('.')[0] for m in sys.modules} & "
        "{'numpy', 'cv2', 'gtsam', 'rerun', 'scipy', 'yaml', 'tqdm'}), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "[]\n"


INFO = ["info", "synth:wall?frames=2&width=96&height=64"]
STILL = ["run", "synth:static?frames=2&width=96&height=64", "--no-overview", "--out", "out"]


@pytest.mark.parametrize(("arguments", "code"), [(INFO, 0), (["--help"], 0), (["--version"], 0), (STILL, 3)])
def test_a_closed_pipe_ends_quietly_with_the_code_of_the_run(arguments, code):
    read, write = os.pipe()
    os.close(read)
    command = [sys.executable, "-m", "slam_init", *arguments]
    done = subprocess.run(command, stdout=write, stderr=subprocess.PIPE, text=True)
    os.close(write)
    assert (done.returncode, done.stderr) == (code, "")


@pytest.mark.parametrize("closed", ["<&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_a_run_without_standard_streams_is_the_same_run(tmp_path, closed):
    command = f"{shlex.quote(sys.executable)} -m slam_init {shlex.join(STILL)} {closed}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (3, "")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["frames_read"] == 2


@pytest.mark.parametrize("raised", ["raise KeyboardInterrupt", "signal.raise_signal(signal.SIGTERM)"])
def test_an_interrupt_in_code_from_a_text_has_the_documented_exit_code(tmp_path, raised):
    code = (
        "import signal, slam_init.runner, slam_init.cli\n"
        f"slam_init.runner.run = lambda *_, **__: exec({raised!r}, {{'signal': signal}})\n"
        "slam_init.cli.entry_point()"
    )
    (tmp_path / "patched.py").write_text(code)
    done = subprocess.run([sys.executable, "-m", "patched", *STILL], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (143 if "SIGTERM" in raised else 130, "slam-init: interrupted\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_stdout_is_one_line():
    command = [sys.executable, "-m", "slam_init", *INFO]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr.startswith("slam-init: error: cannot write to standard output")
    assert len(done.stderr.splitlines()) == 1
