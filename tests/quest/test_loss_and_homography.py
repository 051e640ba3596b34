"""The choice of a robust loss, and the homography of a plane and of a rotation."""

from __future__ import annotations

import numpy as np
import pytest

from quest import InputError, estimate_relative_pose
from quest.noise import LOSSES
from tests.benchmarks.quest.measures import pose_errors_deg
from tests.benchmarks.quest.scenes import FOCAL_PX, SCENES, draw_scene

THRESHOLD_RAD = 2 / FOCAL_PX


def scene_of(name: str, outliers: float):
    rng = np.random.default_rng(3)
    return draw_scene(SCENES[name], rng, matches=200, outlier_share=outliers, noise_px=0.5)


@pytest.mark.parametrize("loss", ["mixture", *LOSSES])
def test_every_loss_finds_the_motion(loss):
    scene = scene_of("general .15", 0.0 if loss == "least_squares" else 0.3)
    pose = estimate_relative_pose(scene.bearings1, scene.bearings2, threshold_rad=THRESHOLD_RAD, loss=loss)
    assert pose.kind == "general" and pose.H is None
    assert max(pose_errors_deg(pose.R, pose.t, scene.R, scene.t)) < 1


def test_another_loss_is_refused():
    scene = scene_of("general .15", 0.0)
    with pytest.raises(InputError, match="loss is 'tukey': give one of mixture, least_squares"):
        estimate_relative_pose(scene.bearings1, scene.bearings2, loss="tukey")


@pytest.mark.parametrize(("name", "kind"), [("plane .15", "planar"), ("rotation", "rotation")])
def test_the_homography_takes_rays_of_a_plane_and_of_a_rotation_to_the_other_view(name, kind):
    scene = scene_of(name, 0.2)
    pose = estimate_relative_pose(scene.bearings1, scene.bearings2, threshold_rad=THRESHOLD_RAD)
    assert pose.kind == kind
    seen = scene.bearings1[pose.inliers] @ pose.H.T
    seen /= np.linalg.norm(seen, axis=1, keepdims=True)
    error = np.linalg.norm(np.cross(seen, scene.bearings2[pose.inliers]), axis=1)
    assert np.median(error) < 1.5 * np.sqrt(2) * 0.5 / FOCAL_PX
