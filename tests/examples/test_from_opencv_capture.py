"""The example that reads an OpenCV capture."""

import cv2
import from_opencv_capture
import pytest
from from_opencv_capture import initialize_from_capture

from slam_init.calibration.files import load_camera

pytestmark = pytest.mark.process

RATE_HZ = 25


@pytest.fixture(scope="module")
def video(room, tmp_path_factory):
    """The room as a video file, and its calibration."""
    folder = tmp_path_factory.mktemp("capture")
    path, camera = folder / "room.avi", room.camera
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE_HZ, (camera.width, camera.height))
    for frame in room.frames(0, 25):
        writer.write(frame.image if frame.image.ndim == 3 else cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR))
    writer.release()
    calibration = folder / "camera.yaml"
    calibration.write_text(
        f"model: pinhole\nwidth: {camera.width}\nheight: {camera.height}\n"
        f"fx: {camera.fx}\nfy: {camera.fy}\ncx: {camera.cx}\ncy: {camera.cy}\n"
    )
    return path, calibration


def test_a_capture_is_read_until_a_map_is_found(room, video):
    lines = []
    capture = cv2.VideoCapture(str(video[0]))
    result = initialize_from_capture(capture, load_camera(video[1]), lines.append)
    assert result
    assert capture.get(cv2.CAP_PROP_POS_FRAMES) == result.frames_to_init < 25
    for keyframe in result.map.keyframes:
        assert keyframe.timestamp_s == pytest.approx(keyframe.frame / RATE_HZ, abs=1e-3)
    assert "waiting" in lines[0]
    assert "100%" in lines[-1]
    assert "initialized" in lines[-1]
    assert len(lines) == len(set(lines)) < result.frames_read


def test_the_program_prints_the_result_and_reports_wrong_arguments(video, capsys):
    path, calibration = map(str, video)
    assert from_opencv_capture.main([path, calibration]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("initialized after")
    assert from_opencv_capture.main([f"{path}.missing", calibration]) == 2
    assert from_opencv_capture.main([path]) == 2
    assert capsys.readouterr().err.count("\n") == 2
