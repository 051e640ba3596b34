"""Laws of the expansion of a fit in all its unknowns and in the fields of correlated errors of the views."""

import numpy as np
import pytest
from make_window import PRIORS, fit_near_truth, make_window

from slam_init.window.arguments import Limits
from slam_init.window.joint_fit import fit_window
from slam_init.window.linearization import linearize_with_fields
from slam_init.window.state import start_at

SCENES = {"general": "room", "plane": "wall"}


@pytest.mark.parametrize("kind", SCENES)
def test_the_expansion_without_its_fields_is_the_information_of_the_fit(kind):
    window = make_window(SCENES[kind], 1, 4, noise_px=0.7, baseline=0.3)
    fit = fit_near_truth(window, kind=kind, seed=1)
    found = linearize_with_fields(fit)
    assert found.is_field.sum() == 12 * 4
    other = ~found.is_field
    largest = np.abs(fit.information).max()
    np.testing.assert_allclose(found.information[np.ix_(other, other)], fit.information, atol=1e-9 * largest)


@pytest.mark.parametrize("kind", SCENES)
def test_the_gradient_of_the_expansion_is_the_sum_of_the_shares_and_vanishes_at_a_fit(kind):
    window = make_window(SCENES[kind], 2, 4, noise_px=0.7, baseline=0.3)
    fit = fit_near_truth(window, kind=kind, seed=2)
    found = linearize_with_fields(fit)
    total, focal = found.shares.sum(axis=0), np.flatnonzero(~found.is_field)[6 * 3]
    total[focal] += fit.state.lens.log_scale / PRIORS.focal_sigma**2
    total[np.flatnonzero(~found.is_field)[6 * 3 + 1]] += fit.state.lens.k1 / PRIORS.k1_sigma**2
    np.testing.assert_allclose(found.gradient, total, atol=1e-7)
    scale = np.sqrt(np.diag(found.information))
    assert np.abs(found.gradient / scale)[~found.is_field].max() < 1e-3
    assert np.abs(found.gradient / scale)[found.is_field].max() > 0.1


def test_the_variance_of_a_distance_is_the_inverse_of_its_curvature():
    """At known poses and focal length, two noisy views of a track in the middle of the image."""
    errors, sigmas = [], []
    for seed in range(40):
        window = make_window("room", seed, 4, 60, noise_px=0.7, baseline=0.3)
        truth = window.true_state()
        fit = fit_window(window.tracks, truth, PRIORS, limits=Limits(max_steps=0))
        moved = start_at(window.tracks, window.R, window.t)
        found = linearize_with_fields(fit)
        used = window.tracks.seen.all(axis=0)
        errors.extend((moved.inverse_distances - truth.inverse_distances)[used])
        sigmas.extend(np.sqrt(found.distance_variance[used]))
    # The start is linear least squares, which is nearly as good as the maximum of the likelihood.
    assert np.sqrt(np.mean((np.array(errors) / sigmas) ** 2)) == pytest.approx(1, abs=0.25)
