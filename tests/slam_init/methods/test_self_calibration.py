"""Laws of the calibration from a whole video."""

from dataclasses import replace

import numpy as np
import pytest

from quest.geometry.quaternion import rotation_from_vector
from slam_init.calibration.files import camera_yaml, load_camera, prior_camera
from slam_init.config import Config
from slam_init.methods.self_calibration import StretchEstimate, by_all_frames, combine
from slam_init.types.camera import Camera
from slam_init.types.frame import Frame, Observations
from slam_init.types.lens import MAX_FOCAL_SIGMA
from slam_init.types.pose import Pose

PRIOR = prior_camera((640, 480))


def stretch(focal_px, sigma, k1=0.0, k1_sigma=0.01):
    return StretchEstimate(0, 10, focal_px, sigma, k1, k1_sigma)


def test_stretches_that_agree_make_the_estimate_more_certain():
    one, four = (combine(PRIOR, [stretch(500.0, 0.04)] * count).camera for count in (1, 4))
    assert one.fx == pytest.approx(500) and four.fx == pytest.approx(500)
    assert 0.5 < four.focal_sigma / one.focal_sigma < 0.6  # what they share stays


def test_stretches_that_contradict_each_other_give_no_camera():
    found = combine(PRIOR, [stretch(450.0, 0.01), stretch(550.0, 0.01)])
    assert found.focal_sigma > MAX_FOCAL_SIGMA
    assert found.camera is None
    assert combine(PRIOR, []).camera is None


def test_a_distortion_is_stated_where_it_is_certain():
    bent = combine(PRIOR, [stretch(500.0, 0.02, k1=-0.2)] * 2).camera
    assert bent.distortion[0] == pytest.approx(-0.2)
    assert combine(PRIOR, [stretch(500.0, 0.02, k1=0.005)]).camera.distortion == ()
    # Both coefficients of a stretch are stated together.
    one = replace(stretch(500.0, 0.02, k1=-0.3), k2=0.1)
    assert combine(PRIOR, [one, one]).camera.distortion[:2] == pytest.approx((-0.3, 0.1))


def test_a_written_calibration_is_read_back(tmp_path):
    found = combine(PRIOR, [stretch(500.0, 0.04, k1=-0.2)]).camera
    size_px, lens = (640, 480), (500.125, 501.0 / 3, 320.1, 240.2)
    fisheye = Camera("fisheye", *size_px, *lens, (0.1, -0.02, 0.003, 0.004), readout_ms=12.5)
    for camera in (found, fisheye, Camera("pinhole", *size_px, *lens)):
        (tmp_path / "camera.yaml").write_text(camera_yaml(camera))
        assert load_camera(tmp_path / "camera.yaml", size_px) == replace(camera, source="file")


BENT = Camera("radtan", 640, 480, 400.0, 400.0, 319.5, 239.5, (-0.3, 0.1, 0.0, 0.0))


class Tracks:
    """Ten frames of points, seen by a camera that turns while it moves, through a lens that bends strongly."""

    def __init__(self, turn=(0.4, 1.0, 0.2), step=(1.0, 0.2, 0.3), wrong=0.0):
        rng = np.random.default_rng(0)
        world = rng.uniform((-4, -3, 4), (4, 3, 10), (300, 3))
        self.poses, self.seen = {}, {}
        for k in range(10):
            R = rotation_from_vector(0.05 * k * np.array(turn))
            self.poses[k] = Pose(R, -R @ (0.15 * k * np.array(step)))
            pixels = BENT.project(self.poses[k].apply(world)) + 0.2 * rng.normal(size=(300, 2))
            outliers = rng.random(300) < wrong
            pixels[outliers] = rng.uniform((0, 0), (640, 480), (outliers.sum(), 2))
            inside = np.isfinite(pixels).all(axis=1) & (pixels > 0).all(axis=1) & (pixels < (640, 480)).all(axis=1)
            self.seen[k] = np.flatnonzero(inside), pixels[inside]

    def frames(self, start=0, max_frames=None):
        blank = np.zeros((480, 640), np.uint8)
        return (Frame(k, k / 30, str(k), blank) for k in range(start, start + (max_frames or 10)))

    def observed(self, frame, camera):
        ids, pixels = self.seen[frame.index]
        rays = camera.bearings(pixels)
        seen = np.isfinite(rays).all(axis=1)
        return Observations(frame.index, frame.timestamp_s, "", ids[seen], pixels[seen], rays[seen])


def lens_from(tracks, poses, camera):
    return by_all_frames(tracks, 0, 10, (poses, camera), PRIOR, Config(), bar=False)


def test_three_poses_and_a_poor_lens_lead_to_the_lens_of_all_frames_beside_outliers_and_a_wrong_motion_to_none():
    tracks = Tracks(wrong=0.05)
    poor = replace(BENT, fx=420.0, fy=420.0, distortion=(-0.22, 0.0, 0.0, 0.0))
    found = lens_from(tracks, {k: tracks.poses[k] for k in (0, 5, 9)}, poor)
    assert (found.first_frame, found.last_frame) == (0, 9)
    assert found.focal_px == pytest.approx(400, rel=0.02) and found.focal_sigma < MAX_FOCAL_SIGMA
    assert (found.k1, found.k2) == pytest.approx(BENT.distortion[:2], abs=0.03)
    backwards = {k: tracks.poses[9 - k] for k in (0, 5, 9)}
    assert lens_from(tracks, backwards, BENT) is None
    assert by_all_frames(tracks, 0, 10, None, PRIOR, Config(), bar=False) is None
    # A lens that is no polynomial of two coefficients stays.
    wide = Camera("fisheye", 640, 480, 300.0, 300.0, 319.5, 239.5, (0.0, 0.0, 0.0, 0.0), focal_sigma=0.3)
    assert by_all_frames(tracks, 0, 10, (tracks.poses, BENT), wide, Config(), bar=False) is None


def test_a_camera_that_moves_straight_ahead_determines_no_focal_length():
    tracks = Tracks(turn=(0.0, 0.0, 0.0), step=(0.0, 0.0, 1.0))
    assert lens_from(tracks, tracks.poses, BENT) is None
