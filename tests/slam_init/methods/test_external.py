"""External programs as methods: what they get, what they may write, and how they are ended."""

import os
import stat
import subprocess
import sys
import time

import numpy as np
import pytest
from paths import ROOT
from process_tree import MARK, left_over, new_mark

from slam_init.calibration.files import load_camera
from slam_init.config import Config, ExternalConfig
from slam_init.errors import ConfigError, SlamInitError, SourceError
from slam_init.methods import make_initializer, method_info
from slam_init.methods.external import ExternalInitializer
from slam_init.methods.external_command import parse_external
from slam_init.methods.external_run import run_program
from slam_init.types.camera import Camera

pytestmark = pytest.mark.process

CAMERA = Camera("radtan", 64, 48, 60.0, 61.0, 31.5, 23.5, (0.1, -0.01, 0.001, 0.002))
FRAMES = 4


def script(tmp_path, text, name="wrapper.sh"):
    """An executable script, and its command."""
    path = tmp_path / name
    path.write_text(f"#!/bin/sh\nimages=$1 times=$2 camera=$3 out=$4\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return f"command:{path} {{images}} {{times}} {{camera}} {{out}}"


def result_of(method, frames=FRAMES, **limits):
    initializer = make_initializer(method, CAMERA, Config(external=ExternalConfig(**limits)))
    for i in range(frames):
        image = np.full((48, 64), 10 * i, np.uint8)
        assert not initializer.process(image, 100.0 + 0.1 * i)
    return initializer.finish()


def line(stamp, x):
    return f"{stamp} {x} 0 0 0 0 0 1"


def test_a_program_gets_images_times_and_calibration_and_its_trajectory_is_the_map(tmp_path):
    copy = tmp_path / "copy of all"
    copy.mkdir()
    text = f"cp -r $images $times $camera '{copy}'\n"
    text += f"printf '{line(100.1, 5)}\\n{line(100.3, 7)}\\n' > $out/trajectory.txt; echo 4 > $out/frames_read.txt"
    result = result_of(script(tmp_path, text))
    assert result and result.frames_to_init == 4
    assert [keyframe.frame for keyframe in result.map.keyframes] == [1, 3]
    # The world frame is the first keyframe's camera.
    assert [keyframe.world_from_cam.t[0] for keyframe in result.map.keyframes] == [0, 2]
    assert load_camera(copy / "camera.yaml") == CAMERA
    assert len(list((copy / "images").iterdir())) == FRAMES
    stamps = [row.split() for row in (copy / "times.txt").read_text().splitlines()]
    assert stamps[2] == ["100.200000000", "000002.png"]


def test_a_program_without_a_trajectory_has_no_map_and_may_say_why(tmp_path):
    assert result_of(script(tmp_path, "exit 0")).reason == "external_method"
    assert result_of(script(tmp_path, "echo pure_rotation > $out/reason.txt")).reason == "pure_rotation"
    assert result_of(script(tmp_path, "echo nonsense > $out/reason.txt")).reason == "external_method"
    assert result_of(script(tmp_path, "exit 0"), frames=1).reason == "too_few_frames"


def test_what_a_program_does_wrong_is_reported_in_one_line(tmp_path):
    for text, cause in (
        ("echo first >&2; echo the reason >&2; exit 3", "exited with 3: the reason"),
        ("kill -SEGV $$", "died"),
        ("printf '1 2 3\\n' > $out/trajectory.txt", "trajectory.txt:1"),
        (f"printf '{line(5.0, 0)}\\n{line(6.0, 1)}\\n' > $out/trajectory.txt", "time stamp of no frame"),
        ("ln -s /etc/hostname $out/trajectory.txt", "leads out of the folder"),
        ("mkfifo $out/trajectory.txt", "named pipe"),
        (f"printf '{line(100.0, 0)}\\n{line(100.3, 1)}\\n' > $out/trajectory.txt; echo 2 > $out/frames_read.txt",
         "from 4"),
    ):  # fmt: skip
        with pytest.raises((SlamInitError, SourceError), match=cause) as error:
            result_of(script(tmp_path, text))
        assert "\n" not in str(error.value)


@pytest.mark.skipif(sys.platform != "linux", reason="processes are counted in /proc")
def test_the_whole_process_group_is_killed_at_the_time_limit_and_at_the_end(tmp_path, monkeypatch):
    mark = new_mark()
    monkeypatch.setenv(MARK, mark)
    with pytest.raises(SlamInitError, match=r"did not end within 0.3 s"):
        result_of(script(tmp_path, "sleep 60 & sleep 60"), time_limit_s=0.3)
    result_of(script(tmp_path, "sleep 60 & exit 0"))  # what it leaves behind ends with it
    assert left_over(mark) == []


@pytest.mark.skipif(sys.platform != "linux", reason="processes are counted in /proc")
def test_a_program_ends_with_the_process_that_runs_it(tmp_path, monkeypatch):
    mark, started = new_mark(), tmp_path / "started"
    monkeypatch.setenv(MARK, mark)
    words = ["sh", "-c", f"sleep 99 & touch {started}; sleep 99"]
    code = f"from slam_init.methods.external_run import run_program; run_program({words}, 99, 0)"
    parent = subprocess.Popen([sys.executable, "-c", code])
    while not started.exists() and parent.poll() is None:
        time.sleep(0.02)
    assert started.exists()
    parent.kill()
    parent.wait()
    assert left_over(mark, within_s=30.0) == []  # the guard notices the end of its pipe


def test_output_and_memory_are_bounded():
    failure, output = run_program([sys.executable, "-c", "print('x' * 3_000_000); print('end')"], 60.0, 0)
    assert failure == "" and output.endswith("end\n") and len(output) < 20_000
    failure, output = run_program([sys.executable, "-c", "b = bytearray(2_000_000_000)"], 60.0, 1000)
    assert "exited with 1" in failure and "MemoryError" in output


def test_the_folder_of_the_frames_is_removed(tmp_path, monkeypatch):
    import tempfile

    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    result_of(script(tmp_path, "exit 0"))
    with pytest.raises(SlamInitError):
        result_of(script(tmp_path, "exit 1"))
    make_initializer(script(tmp_path, "exit 0"), CAMERA, Config()).process(np.zeros((48, 64), np.uint8), 0.0)
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


def test_no_shell_reads_the_command_and_placeholders_are_replaced_after_the_split(tmp_path):
    text = "command:program '{images}/a b' --out={out} $(touch owned) '{unknown}'"
    command = parse_external("command:sh " + text.removeprefix("command:program "))
    assert command.filled({"images": "/a b", "times": "t", "camera": "c", "out": "/o", "count": "2"}) == [
        "sh", "/a b/a b", "--out=/o", "$(touch", "owned)", "{unknown}",
    ]  # fmt: skip


def test_a_wrong_command_is_refused_before_anything_runs():
    for method, cause in (
        ("command:", "names no program"),
        ("command:sh {images}", "lacks {out}"),
        ("command:'sh {images} {out}", "cannot be split"),
        ("x=command:no-such-program-here {images} {out}", "is not found"),
        *((f"{name}=command:true {{images}} {{out}}", "give at most 40 letters") for name in ("a" * 41, "ä", "a/b")),
    ):
        with pytest.raises(ConfigError, match=cause):
            method_info(method)


def test_an_external_program_refuses_tracks(tmp_path):
    from make_window import point_source

    initializer = ExternalInitializer(script(tmp_path, "exit 0"), CAMERA, Config())
    with pytest.raises(SlamInitError, match="needs images"):
        initializer.process_tracks(next(point_source("room", 0).observations()))


def test_the_shell_wrapper_gives_a_folder_of_tum_and_two_keyframes_are_the_map(tmp_path, monkeypatch):
    wrapper = ROOT / "docs" / "examples" / "external_orb_slam3.sh"
    program = tmp_path / "Examples" / "Monocular" / "mono_tum"
    program.parent.mkdir(parents=True)
    program.write_text(
        "#!/bin/sh\ngrep -q 'Camera1.k2: -0.0100000000' $2 && head -4 $3/rgb.txt | tail -1 | grep -q rgb/000000.png"
        f" && printf '{line(100.1, 0)}\\n{line(100.2, 1)}\\n{line(100.3, 9)}\\n' > KeyFrameTrajectory.txt\n"
    )
    program.chmod(0o755)
    method = f"orb=command:sh {wrapper} {{images}} {{times}} {{camera}} {{out}}"
    monkeypatch.delenv("ORB_SLAM3", raising=False)
    with pytest.raises(SlamInitError, match="set ORB_SLAM3"):
        result_of(method)
    monkeypatch.setenv("ORB_SLAM3", str(tmp_path))
    result = result_of(method)
    assert [keyframe.frame for keyframe in result.map.keyframes] == [1, 2]
    assert result.frames_to_init == 3
    assert os.environ["ORB_SLAM3"]
