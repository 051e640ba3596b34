"""Laws of the integral over fields of correlated errors: it equals the full normal equations."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, fit_near_truth, make_window

from slam_init.types.correlated_errors import FIELD_SCALES_PX
from slam_init.window.arguments import Limits
from slam_init.window.joint_fit import fit_window
from slam_init.window.linearization import linearize_with_fields, marginalize_fields

SCENES = {"general": "room", "plane": "wall"}


@pytest.fixture(scope="module", params=SCENES)
def linearization(request):
    """The expansion of a fit of four views; one step short of the optimum, so that its gradient is not zero."""
    window = make_window(SCENES[request.param], 1, 4, 40, noise_px=0.7, baseline=0.3)
    start = window.start(1, window.plane if request.param == "plane" else None, error=1e-3)
    fit = fit_window(window.tracks, start, PRIORS, limits=Limits(max_steps=0))
    return linearize_with_fields(fit)


@pytest.mark.parametrize("kind", SCENES)
def test_the_expansion_without_its_fields_is_the_information_of_the_fit(kind):
    fit = fit_near_truth(make_window(SCENES[kind], 1, 4, noise_px=0.7, baseline=0.3), kind=kind, seed=1)
    found = linearize_with_fields(fit)
    assert found.is_field.sum() == 12 * 4
    other = ~found.is_field
    np.testing.assert_allclose(
        found.information[np.ix_(other, other)], fit.information, atol=1e-9 * np.abs(fit.information).max()
    )


def exact(linearization):
    """The integrals without a bound on the pull."""
    return marginalize_fields(linearization, largest_pull_sigmas=np.inf)


def dense(linearization, scale):
    """Information and gradient with the prior of the fields; for a scale of 0 without the fields."""
    H, g, field = linearization.information, linearization.gradient, linearization.is_field
    if scale == 0:
        return H[np.ix_(~field, ~field)], g[~field]
    return H + np.diag(field / scale**2), g


def functions(linearization):
    """Three linear functions of the unknowns, each in units of its standard deviation without fields."""
    count = int((~linearization.is_field).sum())
    J = np.random.default_rng(0).normal(size=(3, count))
    covariance = np.linalg.inv(dense(linearization, 0.0)[0])
    return J / np.sqrt(np.einsum("mx,xy,my->m", J, covariance, J))[:, None]


def test_without_fields_the_covariance_is_the_inverse_of_the_information_of_the_other_unknowns(linearization):
    found = exact(linearization)
    assert FIELD_SCALES_PX[0] == 0
    information, gradient = dense(linearization, 0.0)
    np.testing.assert_allclose(found.covariance @ information, np.eye(len(information)), atol=1e-6)
    J = functions(linearization)
    shifts, covariances = found.of(J)
    np.testing.assert_allclose(covariances[0], J @ np.linalg.inv(information) @ J.T, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(shifts[0], -J @ np.linalg.solve(information, gradient), rtol=1e-6, atol=1e-8)


def test_without_chance_the_response_is_the_inverse_of_what_is_left(linearization):
    found = exact(linearization)
    information = dense(linearization, 0.0)[0]
    rng = np.random.default_rng(1)
    root = rng.normal(size=(len(information), 5))
    part = root @ root.T
    part *= 0.5 / np.linalg.eigvalsh(np.linalg.solve(information, part).real).max().real
    wider = found.without_chance(part)
    inverse = np.linalg.inv(information - part)
    scale = np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
    np.testing.assert_allclose(wider.response / scale, inverse / scale, atol=1e-6)
    np.testing.assert_allclose(wider.covariance / scale, inverse @ information @ inverse / scale, atol=1e-6)
    np.testing.assert_allclose(wider.coupling, inverse @ information @ found.coupling, rtol=1e-4, atol=1e-6)
    same = found.without_chance(np.zeros_like(part))
    np.testing.assert_allclose(same.covariance / scale, found.covariance / scale, atol=1e-9)


@pytest.mark.parametrize("index", range(1, len(FIELD_SCALES_PX)))
def test_shifts_and_covariances_are_those_of_the_full_normal_equations(linearization, index):
    J = functions(linearization)
    information, gradient = dense(linearization, FIELD_SCALES_PX[index])
    full = np.zeros((3, len(information)))
    full[:, ~linearization.is_field] = J
    shifts, covariances = exact(linearization).of(J)
    np.testing.assert_allclose(shifts[index], -full @ np.linalg.solve(information, gradient), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(covariances[index], full @ np.linalg.solve(information, full.T), rtol=1e-5, atol=1e-6)


def log_integral(linearization, scale):
    """Logarithm of the integral of the likelihood and the prior of the fields over all unknowns, up to a constant."""
    information, gradient = dense(linearization, scale)
    fields = int(linearization.is_field.sum())
    log = 0.5 * gradient @ np.linalg.solve(information, gradient) - 0.5 * np.linalg.slogdet(information)[1]
    # The Gaussian integral has a factor sqrt(2 pi) for each coefficient, which the prior cancels.
    return log - (fields * np.log(scale) if scale else 0.0)


def test_the_evidence_is_the_gaussian_integral_over_all_unknowns(linearization):
    found = exact(linearization).fields.log_evidence
    assert found[0] == 0
    expected = [log_integral(linearization, s) - log_integral(linearization, 0.0) for s in FIELD_SCALES_PX]
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-4)


def test_a_pull_beyond_chance_in_a_direction_that_the_tracks_do_not_determine_is_no_evidence(linearization):
    """Tracks that are held at infinity pull at fields along their epipolar lines, where they have no information."""
    found = marginalize_fields(linearization)
    field, other = np.flatnonzero(linearization.is_field), ~linearization.is_field
    H = linearization.information
    left = H[np.ix_(field, field)] - H[np.ix_(field, other)] @ np.linalg.solve(
        H[np.ix_(other, other)], H[np.ix_(other, field)]
    )
    gradient = linearization.gradient.copy()
    gradient[field] += 10.0 * np.linalg.eigh(left)[1][:, 0]
    pulled = replace(linearization, gradient=gradient)
    np.testing.assert_allclose(marginalize_fields(pulled).fields.log_evidence, found.fields.log_evidence, atol=0.5)
    assert exact(pulled).fields.log_evidence[-1] > found.fields.log_evidence[-1] + 50


def test_a_matrix_that_is_no_covariance_is_a_refusal(linearization):
    marginal = marginalize_fields(linearization)
    broken = replace(marginal, covariance=marginal.covariance - 2 * np.diag(np.diag(marginal.covariance)))
    with pytest.raises(np.linalg.LinAlgError, match="not positive definite"):
        broken.without_chance(np.zeros_like(marginal.covariance))
