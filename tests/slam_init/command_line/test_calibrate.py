"""``slam-init calibrate``."""

import json

from cli_files import IMAGES

from slam_init.cli import main


def test_a_video_that_does_not_tell_is_a_result_and_no_error(world, capsys):
    assert main(["calibrate", IMAGES, "--out", "lens"]) == 3
    assert "not calibrated" in capsys.readouterr().out
    written = json.loads((world / "lens" / "calibration.json").read_text())
    assert written["camera"] is None and written["stretches"] == [] and written["tried"] == 1
    assert not (world / "lens" / "camera.yaml").exists()
