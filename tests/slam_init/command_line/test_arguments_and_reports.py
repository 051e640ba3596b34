"""What arguments do, and what the command line prints."""

import json
from pathlib import Path

import pytest
from cli_files import IMAGES, INITIALIZED, REFUSED, WITH

from slam_init.cli import main
from slam_init.scale.requests import parse_scale


def test_arguments_reach_the_pipeline(world, pipeline, capsys):
    numbers = (
        "--start 1 --max-frames 2 --continue 4 --seed 5 --restart --scale height:1.65 --export scene --matcher orb "
        "--no-overview --max-depth-sigma 0.05 --min-parallax 1.5"
    )
    assert main(["run", IMAGES, *WITH, *numbers.split(), "--out", "results", "--quiet"]) == 0
    ((source, camera, config, options),) = pipeline.calls
    assert (source.kind, len(source), camera.fx, config.seed, config.method) == ("images", 3, 60, 5, "quest")
    assert str(options.pop("out")) == "results"
    assert config.tracking.matcher == "orb"
    assert (config.acceptance.max_depth_sigma, config.acceptance.min_parallax_deg) == (0.05, 1.5)
    assert options == {
        "start": 1, "max_frames": 2, "continue_frames": 4, "progress": False, "overview": False, "viewer": None,
        "restart": True, "scale": parse_scale("height:1.65"), "imu": False,
        "export": ["scene"],
    }  # fmt: skip
    assert capsys.readouterr() == ("", "")


def test_the_readout_of_the_command_line_reaches_the_pipeline(world, pipeline):
    readouts = {"25": (25.0, "down"), "25,up": (25.0, "up"), "0": (0.0, "down"), "auto": (None, "down")}
    for text in readouts:
        assert main(["run", IMAGES, *WITH, "--readout", text, "--quiet"]) == 0
    cameras = [camera for _, camera, _, _ in pipeline.calls]
    assert [(camera.readout_ms, camera.readout_direction) for camera in cameras] == list(readouts.values())


def test_the_seed_makes_the_synthetic_world_too(pipeline, capsys):
    assert main(["run", "--seed", "7"]) == 0
    ((source, _, config, options),) = pipeline.calls
    assert (source.name, source.sequence.seed, config.seed) == ("room", 7, 7)
    assert str(options["out"]) == "slam-init-out"


def test_the_focal_length_is_adjusted_where_the_command_line_or_the_configuration_says_so(world, pipeline):
    Path("c.toml").write_text("seed = 9\n[map]\nmin_resected = 30\n")
    Path("on.toml").write_text("[map]\nrefine_focal = true\n")
    for options in ([], ["--refine-focal"], ["--config", "c.toml", "--refine-focal"], ["--config", "on.toml"]):
        assert main(["run", IMAGES, *WITH, *options]) == 0
    maps = [config.map for _, _, config, _ in pipeline.calls]
    assert [map_.refine_focal for map_ in maps] == [False, True, True, True]
    assert maps[2].min_resected == 30 and pipeline.calls[2][2].seed == 9


def test_without_a_calibration_the_focal_length_is_to_be_estimated(world, pipeline):
    for asked in ([], ["--camera", "auto"], ["--camera", "guess"]):
        assert main(["run", IMAGES, *asked]) == 0
    for _, camera, _, _ in pipeline.calls:
        assert camera.source == "prior" and camera.focal_sigma > 0.2


@pytest.mark.parametrize(("summary", "code"), [(INITIALIZED, 0), (REFUSED, 3)])
@pytest.mark.parametrize("quiet", [[], ["--quiet"]])
def test_json_is_the_summary_and_nothing_else(world, pipeline, capfd, summary, code, quiet):
    pipeline.summary = summary
    assert main(["run", IMAGES, *WITH, "--json", *quiet]) == code
    out, err = capfd.readouterr()
    assert json.loads(out) == summary.as_dict() and err == ""


def test_names_that_no_stream_takes_are_reported_all_the_same(world, capfd):
    (world / IMAGES).rename(world / "\udcff ü")
    for image in (world / "\udcff ü").iterdir():
        image.rename(image.with_name(f"\udcff{image.name}"))
    source = ["\udcff ü", *WITH]
    assert main(["run", *source, "--json", "--out", "out"]) == 3
    out, err = capfd.readouterr()
    assert err == ""
    assert out.isascii() and out == (world / "out" / "summary.json").read_text()
    assert json.loads(out)["source"]["name"] == "\udcff ü"
    assert main(["info", *source]) == 0
    assert "\\udcff ü (images)" in capfd.readouterr().out


def test_synth_writes_what_info_and_run_read(tmp_path, pipeline, capsys):
    assert main(["synth", "wall", "--out", "s", "--frames", "3", "--seed", "4"]) == 0
    assert "3 frames" in capsys.readouterr().out
    assert main(["info", "s", "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert (info["kind"], info["frames"], info["width"], info["camera"]["model"]) == ("tum", 3, 640, "pinhole")
    assert info["ground_truth"]["frames"] == 3 and info["ground_truth"]["path_length"] >= 0
    assert main(["info", "s"]) == 0
    assert "for 3 of 3 frames" in capsys.readouterr().out
    assert main(["run", "s"]) == 0
