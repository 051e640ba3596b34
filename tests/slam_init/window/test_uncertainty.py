"""Laws of the uncertainty of a window: it does not depend on the gauge, and errors have the stated size."""

from dataclasses import replace

import numpy as np
import pytest
from make_window import PRIORS, Window, make_window

from quest.geometry.quaternion import rotation_angle, vector_from_rotation
from slam_init.types.camera import Camera
from slam_init.types.lens import SAME_LENS
from slam_init.window.arguments import Limits
from slam_init.window.joint_fit import fit_window
from slam_init.window.linearization import information_by_chance, linearize_with_fields, marginalize_fields
from slam_init.window.state import Priors
from slam_init.window.uncertainty import (
    ExpandedFit,
    direction_uncertainty,
    inverse_distances,
    moved_by_lens,
    rotation_covariances,
)

#: The focal length is known, since that of the simulated worlds has no error.
KNOWN_FOCAL = Priors(focal_sigma=1e-6)
SCENES = {"general": "room", "plane": "wall"}


def fitted(window: Window, plane: bool, priors: Priors = PRIORS):
    start = window.start(0, window.plane if plane else None, error=1e-3)
    return fit_window(window.tracks, start, priors, limits=Limits(tolerance=1e-6))


def expanded(fit):
    linearization = linearize_with_fields(fit)
    return ExpandedFit(fit, linearization, marginalize_fields(linearization))


@pytest.fixture(scope="module", params=SCENES)
def window_and_fit(request):
    """Five views. The pair is the first and a middle one, so that its baseline is not the longest."""
    window = make_window(SCENES[request.param], 1, 5, 80, noise_px=0.5, baseline=0.3)
    return window, fitted(window, request.param == "plane")


def direction_in_space(found):
    """Covariance (3, 3) of the direction, for any basis."""
    return found.basis.T @ found.covariance @ found.basis


def assert_same_uncertainty(a: ExpandedFit, b: ExpandedFit):
    np.testing.assert_allclose(rotation_covariances(a), rotation_covariances(b), rtol=5e-3, atol=1e-10)
    for view in range(1, len(a.fit.state.R)):
        one, other = (direction_in_space(direction_uncertainty(found, view)) for found in (a, b))
        np.testing.assert_allclose(one, other, rtol=5e-3, atol=1e-3 * np.trace(one))
    one, other = inverse_distances(a), inverse_distances(b)
    assert (one.known == other.known).all()
    np.testing.assert_allclose(one.values, other.values, rtol=1e-9)
    np.testing.assert_allclose(one.sigmas[one.known], other.sigmas[one.known], rtol=5e-3)


def test_the_uncertainty_does_not_depend_on_which_baseline_is_held(window_and_fit):
    _, fit = window_and_fit
    held = [expanded(replace(fit, held_view=view)) for view in (1, 2, 4)]
    assert_same_uncertainty(held[0], held[1])
    assert_same_uncertainty(held[0], held[2])
    # The law is not empty: the distances in the units of the fit have another variance with each held baseline.
    coupling = [e.linearization.distance_coupling[:, ~e.linearization.is_field] for e in held]
    variances = [np.einsum("tx,xy,ty->t", J, e.marginal.covariance, J) for J, e in zip(coupling, held, strict=True)]
    known = inverse_distances(held[0]).known
    assert np.median(variances[2][known] / variances[0][known]) > 1.2 or (
        np.median(variances[0][known] / variances[2][known]) > 1.2
    )


@pytest.mark.parametrize("factor", [0.2, 7.0])
def test_the_uncertainty_does_not_depend_on_the_scale_of_the_map(window_and_fit, factor):
    _, fit = window_and_fit
    state = fit.state
    plane = None if state.plane is None else state.plane / factor
    scaled = replace(state, t=factor * state.t, inverse_distances=state.inverse_distances / factor, plane=plane)
    assert_same_uncertainty(expanded(fit), expanded(replace(fit, state=scaled)))


def with_pair_first(window: Window, current: int) -> Window:
    """The same window with another current view."""
    order = [0, current, *(k for k in range(1, len(window.R)) if k != current)]
    return Window(window.tracks.of_views(tuple(order)), window.R[order], window.t[order], window.points)


def squares_of(window: Window, plane: bool):
    """Normalized squared errors of rotation and direction, and those of the distances."""
    fit = fitted(window, plane, KNOWN_FOCAL)
    found = expanded(fit)
    state = fit.state
    vector = vector_from_rotation(window.R[1] @ state.R[1].T)
    direction = direction_uncertainty(found)
    error = direction.basis @ window.R[1].T @ window.t[1] / np.linalg.norm(window.t[1])
    distances = inverse_distances(found)
    known = distances.known
    expected = np.linalg.norm(window.t[1]) / np.linalg.norm(window.points, axis=1)
    z2 = ((distances.values - expected)[known] / distances.sigmas[known]) ** 2
    return (
        vector @ np.linalg.solve(rotation_covariances(found)[0], vector),
        error @ np.linalg.solve(direction.covariance, error),
        float(z2.mean()),
    )


@pytest.mark.parametrize("kind", SCENES)
def test_errors_have_the_stated_size(kind):
    """The pair is the first and a middle view. The mean over 40 windows; 1 if the covariance is right.

    The bounds are wide: the standard deviation of the mean is 0.13 for the rotation, 0.16 for the direction, and up to
    0.22 for distances that share one error. Fields of correlated errors, which these worlds do not have, add to the
    stated size.
    """
    squares = np.array(
        [
            squares_of(
                with_pair_first(make_window(SCENES[kind], s, 5, 80, noise_px=0.3, baseline=0.3), 2), kind == "plane"
            )
            for s in range(40)
        ]
    )
    rotation, direction, distances = squares.mean(axis=0) / (3, 2, 1)
    assert 0.45 < rotation < 1.4
    assert 0.45 < direction < 1.4
    assert 0.45 < distances < 1.6


def direction_squares(seed: int) -> tuple[float, float]:
    """Normalized squared error of a direction: with all the information, and without that by chance.

    A short drive along a corridor: the parallax of most tracks is no larger than their errors.
    """
    window = make_window("corridor", seed, 4, 200, noise_px=0.7, baseline=0.01)
    fit = fit_window(window.tracks, window.start(seed, error=1e-4), KNOWN_FOCAL, limits=Limits(tolerance=1e-6))
    found = expanded(fit)
    by_chance = information_by_chance(fit)
    without = replace(found, marginal=found.marginal.without_chance(by_chance))
    view = 3
    squares = []
    for one in (found, without):
        stated = direction_uncertainty(one, view)
        estimated, true = (
            R.T @ t / np.linalg.norm(t)
            for R, t in ((fit.state.R[view], fit.state.t[view]), (window.R[view], window.t[view]))
        )
        across = stated.basis @ true
        error = np.arccos(np.clip(estimated @ true, -1, 1)) * across / np.linalg.norm(across)
        squares.append(float(error @ np.linalg.solve(stated.covariance, error)))
    return squares[0], squares[1]


def test_information_by_chance_is_not_counted_where_the_parallax_is_no_larger_than_the_errors():
    """The median over 40 windows, over that of chi-square with two degrees of freedom: 1 if the covariance is right.

    Fields of correlated errors, which these worlds do not have, add to the stated size.
    """
    counted, left_out = np.median([direction_squares(seed) for seed in range(40)], axis=0) / 1.386
    assert counted > 4
    assert 0.1 < left_out < 1.4


@pytest.mark.parametrize("scene", ["room", "tilted-45"])
def test_a_map_whose_lens_is_held_is_as_far_from_the_fit_as_stated(scene):
    """The tracks are those of a lens of another focal length and distortion; the fit moves the lens, a map does not."""
    stated = Camera("pinhole", 640, 480, 500.0, 500.0, 319.5, 239.5)
    true = replace(stated, fx=503.0, fy=503.0, model="radtan", distortion=(0.004, 0.0, 0.0, 0.0))
    window = make_window(scene, 2, 5, 120, noise_px=0.5, baseline=0.4, camera=true, stated=stated, turning=0.03)
    priors = Priors(focal_sigma=0.02, k1_sigma=0.05, principal_sigma_px=2.0, gate_sigmas=100.0)
    plane = window.plane if scene != "room" else None
    free = fit_window(window.tracks, window.start(0, plane, error=1e-3), priors, limits=Limits(tolerance=1e-8))
    held_priors = replace(priors, focal_sigma=1e-7, k1_sigma=1e-7, principal_sigma_px=1e-5)
    start = replace(free.state, lens=SAME_LENS)
    held = fit_window(window.tracks, start, held_priors, limits=Limits(tolerance=1e-8))
    found = moved_by_lens(expanded(free), held=True)

    def directions(fit):
        found = np.einsum("kji,kj->ki", fit.state.R, fit.state.t)[1:]
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    moved_deg = np.degrees(np.linalg.norm(directions(free) - directions(held), axis=1))
    assert moved_deg.max() > 0.05
    np.testing.assert_allclose(found.directions_deg, moved_deg, rtol=0.3, atol=0.02)
    turned_deg = np.degrees(rotation_angle(np.swapaxes(free.state.R[1:], 1, 2) @ held.state.R[1:]))
    np.testing.assert_allclose(found.rotations_deg, turned_deg, rtol=0.3, atol=0.02)
