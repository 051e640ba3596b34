"""Random matches have no pose, and one patch of matches is no rotation."""

import numpy as np
import pytest
from make_two_views import NO_TRANSLATION, NOISE_RAD, box, random_rays, unit, views

from quest import estimate_relative_pose
from quest.chance import chance_of_motion
from quest.robust.pose_problem import PoseProblem

SEEDS = range(20)
FOCAL_PX = 458.0


def patch(seed, count, on_patch):
    """Matches of which some lie on a patch of 60 px that moves as one; the others are random over 640x480 px."""
    rng = np.random.default_rng([seed, on_patch])
    pixels1, pixels2 = (rng.uniform((-320, -240), (320, 240), (count, 2)) for _ in range(2))
    centre, moved = rng.uniform((-260, -180), (260, 180)), rng.uniform(-40, 40, 2)
    pixels1[:on_patch] = centre + rng.uniform(-30, 30, (on_patch, 2))
    pixels2[:on_patch] = pixels1[:on_patch] + moved
    return (
        unit(np.column_stack([(pixels + 0.5 * rng.normal(size=pixels.shape)) / FOCAL_PX, np.ones(count)]))
        for pixels in (pixels1, pixels2)
    )


@pytest.mark.parametrize("count", [20, 60, 200, 500])
def test_random_matches_have_no_pose(count):
    """At most one search in a thousand may find one; of 20 none does."""
    for seed in SEEDS:
        rng = np.random.default_rng([seed, count])
        found = estimate_relative_pose(random_rays(rng, count), random_rays(rng, count), seed=seed, max_samples=3000)
        assert not found
        assert found.reason == "no_consistent_motion"
        assert found.evidence.false_alarms is None or found.evidence.false_alarms > 0.1


@pytest.mark.parametrize(("on_patch", "count"), [(12, 40), (20, 60), (33, 100), (150, 400)])
def test_matches_of_one_patch_among_random_ones_are_no_rotation(on_patch, count):
    for seed in SEEDS:
        found = estimate_relative_pose(*patch(seed, count, on_patch), threshold_rad=2 / FOCAL_PX, max_samples=3000)
        # Hundreds of matches may show that the patch does not turn as a rotation would turn it.
        assert not found or (on_patch > 100 and found.kind != "rotation")


@pytest.mark.parametrize(("count", "outliers"), [(30, 0.4), (100, 0.7), (400, 0.7)])
def test_a_rotation_that_matches_all_over_the_view_obey_is_found_among_outliers(count, outliers):
    kinds = []
    for seed in SEEDS:
        both = views(box(seed, count), t=NO_TRANSLATION, noise_rad=NOISE_RAD, outliers=outliers, seed=seed)
        kinds.append(getattr(estimate_relative_pose(*both, max_samples=3000), "kind", ""))
    assert kinds.count("rotation") >= 19
    assert "general" not in kinds


def test_fewer_inliers_are_more_often_chance():
    m, n = views(box(0, 100), noise_rad=NOISE_RAD)
    pose = estimate_relative_pose(m, n)
    model, previous = np.concatenate([pose.q_wxyz, pose.t]), 0.0
    for wrong in (0, 20, 40, 60, 80):
        n[:wrong] = random_rays(np.random.default_rng(1), wrong)
        chance = chance_of_motion(PoseProblem(m, n, 2e-3), model, 2e-3, np.random.default_rng(2)).false_alarms
        assert chance > previous
        previous = chance
