"""The examples run, and do what they say: an OpenCV capture, and features and matches of one's own."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from make_scene import texture, window

import slam_init.examples.own_tracks as own_tracks_module
from slam_init.calibration.files import load_camera
from slam_init.compare.measures import pose_errors
from slam_init.examples import from_opencv_capture, own_tracks
from slam_init.examples.from_opencv_capture import initialize_from_capture
from slam_init.examples.own_tracks import OrbTracks

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


def test_a_capture_is_read_until_there_is_a_map(room, video):
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


def test_the_capture_example_tells_what_came_of_it(video, capsys):
    path, calibration = map(str, video)
    assert from_opencv_capture.main([path, calibration]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("initialized after")
    assert from_opencv_capture.main([f"{path}.missing", calibration]) == 2
    assert from_opencv_capture.main([path]) == 2
    assert capsys.readouterr().err.count("\n") == 2


def test_a_capture_without_motion_tells_what_would_help(video, tmp_path, capsys):
    writer = cv2.VideoWriter(str(tmp_path / "still.avi"), cv2.VideoWriter.fourcc(*"MJPG"), RATE_HZ, (640, 480))
    image = cv2.cvtColor(texture(0, 480, 640), cv2.COLOR_GRAY2BGR)
    for _ in range(4):
        writer.write(image)
    writer.release()
    assert from_opencv_capture.main([str(tmp_path / "still.avi"), str(video[1])]) == 3
    assert "static_camera: the camera stands still" in capsys.readouterr().out


def test_own_tracks_stay_on_their_features():
    image, tracks = texture(0, 480, 900), OrbTracks(500)
    seen = [tracks.track(window(image, 7 * k, 0, 640, 480, k).gray) for k in range(4)]
    for (ids1, pixels1), (ids2, pixels2) in pairwise(seen):
        assert (np.diff(ids2) > 0).all()
        common, i, j = np.intersect1d(ids1, ids2, return_indices=True)
        assert len(common) > 0.5 * len(ids2)
        off = np.linalg.norm(pixels2[j] - pixels1[i] + (7, 0), axis=1)
        assert np.mean(off < 2) > 0.95


def test_a_feature_that_was_hidden_gets_its_track_back_and_a_blank_image_none():
    image, tracks = texture(1, 480, 640), OrbTracks(300)
    before, pixels = tracks.track(image)
    hidden, _ = tracks.track(np.full((480, 640), 90, np.uint8))
    after, again = tracks.track(image)
    assert len(hidden) == 0
    common, i, j = np.intersect1d(before, after, return_indices=True)
    assert len(common) > 0.9 * len(before)
    assert np.mean(np.linalg.norm(pixels[i] - again[j], axis=1) < 1) > 0.95


def test_own_tracks_initialize_correctly(room):
    result = own_tracks.initialize_from_tracks(room.camera, room.frames(0, 40))
    assert result
    errors = pose_errors(result.map, room.groundtruth)
    assert errors.rotation_deg < 2
    assert errors.direction_deg < 5


def test_the_example_of_own_tracks_tells_what_came_of_it(room, capsys, monkeypatch):
    assert own_tracks.main(["synth:static?frames=4&width=320&height=240"]) == 3
    assert "static_camera" in capsys.readouterr().out
    assert own_tracks.main(["synth:nowhere"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    monkeypatch.setattr(own_tracks_module, "open_source", lambda name: room)
    assert own_tracks.main([]) == 0
    assert "initialized after" in capsys.readouterr().out
