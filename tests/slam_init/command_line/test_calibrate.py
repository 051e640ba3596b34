"""``slam-init calibrate``."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from cli_files import IMAGES

from slam_init.calibration.files import camera_yaml, prior_camera
from slam_init.cli import main


def test_a_video_that_does_not_determine_the_lens_is_a_result_and_no_error(world, capsys):
    assert main(["calibrate", IMAGES, "--out", "lens"]) == 3
    assert "not calibrated" in capsys.readouterr().out
    written = json.loads((world / "lens" / "calibration.json").read_text())
    assert written["camera"] is None and written["stretches"] == [] and written["tried"] == 1
    assert not (world / "lens" / "camera.yaml").exists()


def images(folder, picture):
    folder.mkdir()
    for k in range(4):
        cv2.imwrite(str(folder / f"{k}.png"), picture)


@pytest.mark.parametrize(("name", "message"), [("black", "light, focus or texture"), ("static", "stands still")])
def test_images_without_texture_or_motion_are_reported_before_the_lens(name, message, tmp_path, monkeypatch, capsys):
    texture = np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8)
    images(tmp_path / "seq", np.zeros_like(texture) if name == "black" else cv2.GaussianBlur(texture, (0, 0), 1.5))
    monkeypatch.chdir(tmp_path)
    assert main(["calibrate", "seq", "--out", "lens"]) == 3
    text = capsys.readouterr().out
    assert message in text and "turn the camera" not in text
    assert json.loads((tmp_path / "lens" / "calibration.json").read_text())["advice"] in text


@pytest.mark.parametrize(("sigma", "message"), [(0.009, False), (0.05, True)])
def test_a_camera_that_calibrate_wrote_is_a_calibration(sigma, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    camera = replace(prior_camera((320, 240)), fx=262.5, fy=262.5, source="estimated", focal_sigma=sigma)
    (tmp_path / "camera.yaml").write_text(camera_yaml(camera))
    words = ["run", "synth:room?frames=24&width=320&height=240", "--camera", "camera.yaml", "--no-overview"]
    assert main([*words, "--method", "essential-8pt"]) == 0
    assert ("expect a bent map" in capsys.readouterr().out) == message


@pytest.mark.parametrize(
    ("sigmas", "message"),
    [
        ([0.08], "1 of 3 stretches fix the focal length to 8.1%"),
        ([0.03], "one stretch only"),
        ([0.03, 0.03], "by 2 of 3"),
    ],
)
def test_what_is_known_of_the_lens_is_reported(sigmas, message, world, capsys, monkeypatch):
    from slam_init.methods import self_calibration

    prior = prior_camera((64, 48))
    stretches = [self_calibration.StretchEstimate(0, 9, 50.0, sigma, 0.0, 0.01) for sigma in sigmas]
    found = replace(self_calibration.combine(prior, stretches), tried=3)
    monkeypatch.setattr(self_calibration, "calibrate", lambda *_, **__: found)
    assert main(["calibrate", IMAGES, "--out", "lens"]) == (3 if found.camera is None else 0)
    assert message in capsys.readouterr().out
    assert (world / "lens" / "camera.yaml").exists() == (found.camera is not None)
