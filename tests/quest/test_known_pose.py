"""A known pose: refinement without samples, an estimate that begins with it, and the matrices of a pose."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, R_TRUE, T_TRUE, box, is_true, plane, views

from quest import InputError, estimate_relative_pose, refine_relative_pose
from quest.geometry.quaternion import quaternion_from_matrix, rotation_from_vector

#: A start that is off by a degree and five degrees.
NEAR = (rotation_from_vector([0.01, -0.01, 0.01]) @ R_TRUE, T_TRUE + np.array([0.0, 0.05, 0.0]))


@pytest.mark.parametrize(("scene", "kind"), [(box, "general"), (plane, "planar")], ids=["general", "planar"])
def test_a_near_pose_is_refined_to_that_of_the_search(scene, kind):
    m, n = views(scene(0), noise_rad=NOISE_RAD, outliers=0.5)
    refined, found = refine_relative_pose(m, n, NEAR), estimate_relative_pose(m, n)
    assert refined.kind == found.kind == kind
    assert refined.evidence.samples == 0
    assert is_true(refined, found.R, found.t, rotation_deg=0.05, direction_deg=0.3)
    assert len(refined.alternatives) == len(found.alternatives)


def test_the_start_may_be_a_quaternion_and_its_translation_has_any_length():
    m, n = views(box(1), noise_rad=NOISE_RAD)
    first = refine_relative_pose(m, n, NEAR)
    second = refine_relative_pose(m, n, (quaternion_from_matrix(NEAR[0]), 7 * NEAR[1]))
    np.testing.assert_allclose(first.R, second.R, atol=1e-9)
    np.testing.assert_allclose(first.t, second.t, atol=1e-9)


def test_a_pose_far_from_the_truth_is_no_pose():
    m, n = views(box(0), noise_rad=NOISE_RAD)
    assert not refine_relative_pose(m, n, (rotation_from_vector([1.0, 1.0, 0.0]), [0.0, 0.0, 1.0]))


def test_a_good_start_saves_samples_and_a_wrong_start_costs_nothing():
    m, n = views(box(2, 400), noise_rad=NOISE_RAD, outliers=0.6)
    without = estimate_relative_pose(m, n)
    for start in (NEAR, (np.eye(3), [0.0, 0.0, 1.0])):
        pose = estimate_relative_pose(m, n, initial_pose=start)
        assert is_true(pose, rotation_deg=0.5, direction_deg=3)
        assert pose.evidence.samples <= without.evidence.samples


@pytest.mark.parametrize("start", [None, NEAR[0], (NEAR[0],), (np.ones((3, 3)), [1, 0, 0]), (NEAR[0], [0, 0, 0])])
def test_a_start_that_is_no_pose_is_refused(start):
    with pytest.raises(InputError):
        refine_relative_pose(*views(box(0)), start)


def test_the_essential_and_the_fundamental_matrix_fit_the_matches():
    K1, K2 = np.diag([500.0, 510.0, 1.0]), np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
    m, n = views(box(0))
    pose = estimate_relative_pose(m, n)
    assert np.abs(np.einsum("ij,jk,ik->i", n, pose.E, m)).max() < 1e-7
    pixels1, pixels2 = (rays @ K.T for rays, K in ((m, K1), (n, K2)))
    F = pose.fundamental_matrix(K1, K2)
    assert np.linalg.norm(F) == pytest.approx(1)
    assert np.abs(np.einsum("ij,jk,ik->i", pixels2, F, pixels1)).max() < 1e-3
    assert not estimate_relative_pose(*views(box(0), t=NO_TRANSLATION, noise_rad=NOISE_RAD)).E.any()
    with pytest.raises(InputError):
        pose.fundamental_matrix(np.zeros((3, 3)))
