"""Every lens initializes from tracks; rays behind the image plane take part, and with a rolling shutter too."""

from dataclasses import replace

import numpy as np
import pytest
from make_lenses import LENSES, tracks

from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init import Initializer

#: Lenses whose images of 640x480 pixels see rays behind the image plane.
WIDE = ("fisheye", "thin-prism-fisheye", "omni", "double-sphere", "eucm", "equirectangular")


def errors_deg(map_, step=0.02):
    """Largest errors of the rotations and of the directions of the baselines, for the motion of the tracks."""

    def pose(frame):
        return rotation_from_vector(np.array([0.002, 0.006, 0.003]) * frame), step * frame * np.array([1.0, 0.0, 0.3])

    R0, t0 = pose(map_.keyframes[0].frame)
    rotations, directions = [], []
    for keyframe in map_.keyframes[1:]:
        R, t = pose(keyframe.frame)
        rotations.append(rotation_angle((R0.T @ R).T @ keyframe.world_from_cam.R))
        true, found = R0.T @ (t - t0), keyframe.world_from_cam.t
        directions.append(np.arccos(np.clip(true @ found / np.linalg.norm(true) / np.linalg.norm(found), -1, 1)))
    return np.degrees(max(rotations)), np.degrees(max(directions))


@pytest.mark.parametrize("model", LENSES)
def test_every_lens_initializes_and_rays_behind_the_image_plane_become_landmarks(model):
    initializer = Initializer(LENSES[model])
    assert any(initializer.process_tracks(observed) for observed in tracks(LENSES[model], 15))
    rotation_deg, direction_deg = errors_deg(initializer.map)
    assert rotation_deg < 0.1
    assert direction_deg < 5
    assert initializer.map.reprojection_rmse_px < 0.3
    behind = int((initializer.map.points[:, 2] < 0).sum())
    assert behind >= 20 if model in WIDE else behind == 0


def test_a_camera_that_only_rotates_is_refused_through_a_wide_lens():
    initializer = Initializer(LENSES["double-sphere"])
    assert not any(initializer.process_tracks(observed) for observed in tracks(LENSES["double-sphere"], 15, step=0.0))
    assert initializer.finish().reason == "pure_rotation"


def test_a_wrong_focal_length_of_a_wide_lens_gives_no_wrong_map():
    true = LENSES["double-sphere"]
    stated = replace(true, fx=1.04 * true.fx, fy=1.04 * true.fy)
    initializer = Initializer(stated)
    for observed in tracks(true, 15):
        rays = stated.bearings(observed.pixels)
        seen = np.isfinite(rays).all(axis=1)
        if initializer.process_tracks(
            replace(observed, track_ids=observed.track_ids[seen], pixels=observed.pixels[seen], bearings=rays[seen])
        ):
            rotation_deg, direction_deg = errors_deg(initializer.map)
            assert rotation_deg < 0.2
            assert direction_deg < 10
