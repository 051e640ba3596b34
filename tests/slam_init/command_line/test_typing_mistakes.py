"""Mistakes that people make at the keyboard: the line names what was meant."""

import os
import subprocess
import sys

import pytest
from cli_files import IMAGES, WITH

from slam_init.cli import main
from slam_init.methods.registry import METHODS


def error_of(words, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["run", "x", "--max-frame", "3"], "did you mean --max-frames? (see slam-init run --help)"),
        (["run", "x", "camera.yaml"], "unrecognized arguments: camera.yaml (see slam-init run --help)"),
        (["rum", "x"], "choose from 'run', 'view'"),
        (["run", "points:room"], "it is for slam-init compare"),
        (["run", "synth:static?frames=2&width=96&height=64", "--topic", "/a"], "choose those of a ROS bag"),
        (["run", "synth:static?frames=2&width=96&height=64", "--imu"], "has no gyroscope"),
        (["run", "synth:static?frames=2&width=96&height=64", "--scale", "imu"], "has no accelerations"),
        (["run", "synth:static?frames=2&width=96&height=64", "--gravity", "imu"], "has no accelerations"),
        (["run", "synth:static?frames=2&imu=1&cut=1"], "leave cut out"),
        (["synth:room"], "did you mean slam-init run synth:room? (see slam-init --help)"),
        (["run", "synth:rom"], "unknown scene 'rom': did you mean room? use one of room, wall"),
        (["run", "x", "--method", "orbslam3"], "did you mean orb-slam3?"),
    ],
)
def test_an_option_and_a_method_that_do_not_exist_are_reported_with_the_nearest_one(words, meant, capsys):
    assert meant in error_of(words, capsys)


@pytest.mark.parametrize("command", ["run", "compare"])
def test_the_methods_are_listed_one_a_line(command, capsys):
    assert len(error_of(["run", "x", "--method", "nope"], capsys)) < 240
    assert main([command, "--list-methods"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == list(METHODS)
    assert max(len(line) for line in lines) <= 140


@pytest.mark.parametrize(
    ("number", "meant"),
    [("615", "say f=615 for a focal length in pixels\n"), ("81", "f=81 for a focal length in pixels, or fov")],
)
def test_a_bare_number_as_camera_is_answered_with_the_right_option(number, meant, world, capsys):
    assert meant in error_of(["run", IMAGES, "--camera", number], capsys)


def test_the_scale_of_a_truth_that_a_source_does_not_have_is_refused_before_the_run(world, capsys):
    assert "has no true trajectory: leave --scale out" in error_of(
        ["run", IMAGES, *WITH, "--scale", "groundtruth"], capsys
    )


@pytest.mark.parametrize(("line", "wanted"), [("slam-init ru", {"run "}), ("slam-init run --cam", {"--camera "})])
def test_the_shell_completes_what_may_come_next(line, wanted, tmp_path):
    pytest.importorskip("argcomplete")
    asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1"}
    asked["_ARGCOMPLETE_STDOUT_FILENAME"] = "next"
    code = "from slam_init.cli import entry_point; entry_point()"
    subprocess.run([sys.executable, "-c", code], env=os.environ | asked, cwd=tmp_path, check=False)
    assert set((tmp_path / "next").read_text().split("\013")) == wanted
