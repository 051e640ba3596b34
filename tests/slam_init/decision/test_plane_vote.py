"""Laws of the vote on the two explanations of a plane: it decides for the truth, or it does not decide."""

from dataclasses import replace

import numpy as np
import pytest
from make_scene import CAMERA, observe, plane, table

from quest import estimate_relative_pose
from quest.geometry.quaternion import rotation_angle, rotation_from_vector
from slam_init.decision.plane_vote import plane_margin
from slam_init.mapping.views import table_of
from slam_init.types.pose import Pose

#: Towards a plane in a curve, so that all points lie in front of the cameras of the twin as well.
CURVE = [
    Pose(
        rotation_from_vector(np.array([0.01, -0.02, 0.01]) * k),
        np.array([0.03 * k + 0.012 * k * k, 0.01 * k, 0.09 * k]),
    )
    for k in range(5)
]


def true_and_twin(seen, poses):
    """The two explanations of the first and the last view, the true one first, and the noise of a bearing."""
    pose = estimate_relative_pose(seen[0].bearings, seen[-1].bearings, threshold_rad=2 / CAMERA.focal_px, seed=0)
    assert pose.kind == "planar"
    both = [pose, *pose.alternatives]
    assert len(both) == 2
    truth = poses[-1].inverse() @ poses[0]
    return *sorted(both, key=lambda each: rotation_angle(each.R.T @ truth.R)), pose.noise_rad


@pytest.mark.parametrize("seed", range(3))
def test_views_in_a_curve_decide_for_the_truth(seed):
    rng = np.random.default_rng(seed)
    seen = observe(CAMERA, CURVE, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, CURVE)
    there = plane_margin(table(seen), true, twin, noise_rad)
    back = plane_margin(table(seen), twin, true, noise_rad)
    assert there.decides()
    assert replace(there, z=3.5, log_likelihood=25.0).decides()  # a vote of free points needs z = 4
    assert (back.log_likelihood, back.z) == pytest.approx((-there.log_likelihood, -there.z))


@pytest.mark.parametrize("seed", range(3))
def test_any_number_of_views_that_repeat_the_pair_decide_nothing(seed):
    """Two views have two explanations, and copies of the same two views have the same explanations."""
    rng = np.random.default_rng(seed)
    poses = [CURVE[0], *[CURVE[4]] * 5]
    seen = observe(CAMERA, poses, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, poses)
    vote = plane_margin(table(seen), true, twin, noise_rad)
    assert not vote.decides()
    assert not vote.reversed().decides()


def test_there_is_no_vote_without_a_third_view_of_the_plane():
    rng = np.random.default_rng(0)
    seen = observe(CAMERA, CURVE, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, CURVE)
    assert plane_margin(table_of(seen[0], seen[-1], []), true, twin, noise_rad) is None
    few = 8
    blind = replace(
        seen[2], track_ids=seen[2].track_ids[:few], pixels=seen[2].pixels[:few], bearings=seen[2].bearings[:few]
    )
    assert plane_margin(table_of(seen[0], seen[-1], [blind]), true, twin, noise_rad) is None


def test_there_is_no_vote_if_a_ray_is_far_off_the_optical_axis():
    rng = np.random.default_rng(0)
    seen = observe(CAMERA, CURVE, plane(rng, 300), 0.4, rng)
    true, twin, noise_rad = true_and_twin(seen, CURVE)
    beside = table(seen)
    beside.bearings[2, 7] = [1.0, 0.0, 0.05]
    assert plane_margin(beside, true, twin, noise_rad) is None
