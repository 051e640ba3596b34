"""Laws of the points that a fit hands to the next one."""

import numpy as np
import pytest
from make_window import hypotheses_of, pair_and_further, point_source

from slam_init.window.hypotheses import fit_hypotheses
from slam_init.window.joint_fit import MAX_STEPS
from slam_init.window.state import Priors

PRIORS = Priors(focal_sigma=0.03)


def fitted(scene="room", seed=0, views=6):
    source = point_source(scene, seed, baseline=0.3)
    observations = list(source.observations())
    picks = np.linspace(0, len(observations) - 1, views).round().astype(int)
    return hypotheses_of(source.camera, pair_and_further([observations[k] for k in picks], views), PRIORS)


@pytest.mark.parametrize("scene", ["room", "wall"])
def test_a_fit_that_goes_on_takes_few_steps_and_costs_no_more(scene):
    first = fitted(scene)
    again = fit_hypotheses(first.tracks, [one.motion for one in first.motions], PRIORS, first.rotations)
    best = again.motions[0]
    assert best.fit.iterations <= MAX_STEPS
    assert best.fit.cost <= first.motions[0].fit.cost + 0.2
    assert best.same_as(first.motions[0])
    assert again.rotation_only.cost <= first.rotation_only.cost + 0.2
