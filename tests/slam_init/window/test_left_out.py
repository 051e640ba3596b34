"""Laws of a motion that stands on one half of the view."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, hypotheses_of, pair_and_further, point_source

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.pose import Pose
from slam_init.window import left_out
from slam_init.window.left_out import wrong_by_a_half
from slam_init.window.levels import UNDECIDED
from slam_init.window.motion import Motion, errors_if


def hypotheses(seed, baseline, **options):
    source = point_source("room", seed, baseline=baseline, noise_px=0.3, points=150, **options)
    return hypotheses_of(source.camera, pair_and_further(list(source.observations()), 6), PRIORS)


@pytest.mark.parametrize("baseline", [0.05, 0.3])
@pytest.mark.parametrize("seed", range(3))
def test_each_half_of_a_rigid_scene_agrees_however_short_the_baseline_and_however_many_outliers(seed, baseline):
    assert wrong_by_a_half(hypotheses(seed, baseline, outliers=0.3)) == 0


@pytest.mark.parametrize("seed", range(4))
def test_a_body_on_half_of_the_tracks_of_a_short_baseline_shows_where_one_motion_explains_it_and_the_scene(seed):
    body = {"moving": 0.5, "bodies": 1, "body_turn_deg_s": 0}
    assert wrong_by_a_half(hypotheses(seed, 0.05, **body)) > UNDECIDED


def motion(pair=(1.0, 0.0, 0.0), near=(0.1, 0.0, 0.0), near_turned_deg=0.0):
    """A reference, the second view of the pair, and a view at a tenth of its baseline."""
    R = rotation_from_vector(np.radians([0.0, near_turned_deg, 0.0]))
    return Motion({0: Pose.identity(), 5: Pose(np.eye(3), np.array(pair)), 1: Pose(R, R @ np.array(near))})


def test_a_motion_errs_by_its_rotations_and_by_the_directions_of_long_baselines():
    right = motion()
    assert errors_if(motion(), right) == pytest.approx((0, 0), abs=1e-6)
    assert errors_if(motion(near=(0.0, 0.1, 0.0)), right) == pytest.approx((0, 0), abs=1e-6)  # a short baseline
    assert errors_if(motion(near=(0.0, 0.4, 0.0)), right) == pytest.approx((0, 90 / 15), abs=1e-6)
    assert errors_if(motion(near_turned_deg=6.0), right) == pytest.approx((0, 6 / 5), abs=1e-6)
    turned = motion(pair=(1.0, np.tan(np.radians(12)), 0.0))
    assert errors_if(turned, right) == pytest.approx((12 / 15, 12 / 15))


def test_the_probability_grows_with_the_gain_from_none_to_certainty():
    values = [left_out._probability(z) for z in (0.0, 1.5, 2.0, 3.0, 4.0, 6.0, 12.0)]
    assert values == sorted(values)
    assert values[0] == 0
    assert values[2] < 0.005 < values[3]
    assert values[-1] > 0.999


def test_a_half_of_a_few_tracks_tells_no_motion():
    few = hypotheses(0, 0.3)
    explains = few.motions[0].fit.explains.copy()
    explains[np.flatnonzero(explains)[10:]] = False
    best = replace(few.motions[0], fit=replace(few.motions[0].fit, explains=explains))
    assert wrong_by_a_half(replace(few, motions=(best,))) == 0
