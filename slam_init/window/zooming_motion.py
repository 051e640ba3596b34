"""A camera that moves while its lens zooms: a rival of the best motion, with any direction of its own.

A zoom of a view looks like a motion toward what the camera sees, so that a motion that is fitted without zooms may have
any direction: with a zoom by 3 to 50 % that was added to drawn worlds, 41 of 182 maps were false. The expansion of the
fit (:func:`slam_init.window.uncertainty.varying_lens`) knows zooms near that fit only. Here the zooms of all views but
the first are unknowns that are fitted with the motion, from two starts: the best motion, and the motions that a second
look finds where the zooms of a camera that only rotates are undone.

How a zoom proceeds in time is not known. It is a smooth random function of time (Matern 3/2), with the length of the
window as its scale. The zooms lower the cost by chance too, so they are integrated out (Laplace), for each of some
standard deviations: what the tracks tell about them counts against them, and what they do not tell costs nothing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from slam_init.types.arrays import Floats
from slam_init.window.hypotheses import WindowHypotheses, with_plane
from slam_init.window.joint_fit import JointFit, fit_window
from slam_init.window.levels import EVEN_ODDS, FLOOR, LARGEST_ZOOM, WRONG_DIRECTION_DEG, ZOOMED_COST
from slam_init.window.linearization import linearize_with_fields
from slam_init.window.motion import fit_motion
from slam_init.window.other_motion import bearings_of_best
from slam_init.window.second_look import look_again
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tails import two_directions
from slam_init.window.tracker_errors import gain_of_lasting_errors
from slam_init.window.tracks import WindowTracks
from slam_init.window.uncertainty import direction_derivatives
from slam_init.window.varying_lens import shrunk_noise, zoom_covariance, zooms_and_shifts
from slam_init.window.zooming_rotation import ZoomingRotation, zoomed

#: Standard deviations of a zoom within a window, alike probable: from that of a lens that focuses to a factor of 1.3.
#: Class: assumption.
_ZOOM_SIGMAS = (0.03, 0.1, 0.3)
#: Rounds of zooms and motions in turn, the steps of the motion in each, and how often a step of the zooms is tried,
#: each time at this share of its length. It ends where zooms move by less than a tenth of a pixel at the border of an
#: image, or where a round gains less than this (nats).
_ROUNDS, _STEPS, _TRIES, _SHORTER, _CONVERGED, _LEAST_GAIN = 10, 8, 3, 0.3, 2e-4, 0.2
#: Longest step of a zoom: its effect on the pixels is expanded to the first order.
_LONGEST_STEP = 0.15


@dataclass(frozen=True, eq=False)
class ZoomingMotion:
    """A motion with a zoom of each view."""

    #: To the tracks with the zooms undone.
    fit: JointFit
    #: (V,) Of its views; 0 for the first.
    zooms: Floats
    #: Logarithm of the probability of the tracks, the zooms integrated out, over that of the best motion without zooms.
    log_evidence: float
    #: Standard deviation of the direction of the pair where it is largest, by the expansion.
    direction_sigma_deg: float


def wrong_by_zooms(hypotheses: WindowHypotheses, rotation: ZoomingRotation) -> float:
    """Probability that the camera moves and zooms, and that the best motion is wrong then.

    A motion is wrong where the direction of the zooming one is far from it, or unknown; or where the tracks tell zooms
    beyond those of a lens that focuses, as a map knows one focal length only. The zoom of a second view alone takes up
    what a body does, and has no other one to agree with.

    * ``rotation``: The rotation-only camera with zooms.
    """
    log_prior = -0.5 * ZOOMED_COST + math.log(max(hypotheses.priors.lens_changes, 1e-300))
    best, wrong = hypotheses.motions[0], 0.0
    for found in zooming_motions(hypotheses, rotation):
        odds = log_prior + found.log_evidence
        probability = 1 / (1 + math.exp(min(max(-odds, -700.0), 700.0)))
        pair = replace(best, fit=found.fit)
        aside_deg = math.hypot(found.direction_sigma_deg, pair.difference_deg(best)[1])
        far = float(two_directions(WRONG_DIRECTION_DEG, np.array([aside_deg]))[0])
        told = probability > EVEN_ODDS and len(found.zooms) > 2 and np.abs(found.zooms).max() > LARGEST_ZOOM
        wrong = max(wrong, probability * (1.0 if told else far))
    return wrong


def zooming_motions(hypotheses: WindowHypotheses, rotation: ZoomingRotation) -> Iterator[ZoomingMotion]:
    """The motions with zooms that the best motion leads to, and the zooms of the camera that only rotates."""
    best, priors = hypotheses.motions[0], hypotheses.priors
    # The fit without zooms goes on as far as those with zooms.
    held = fit_window(best.tracks, best.fit.state, priors, max_steps=_ROUNDS * _STEPS)
    # What a tracker keeps from view to view grows with the displacement of the image, as the effect of a zoom does.
    dispersion = held.dispersion * gain_of_lasting_errors(best.tracks, held.state.R)
    for tracks, fit, zooms in _starts(hypotheses, held, rotation):
        found, lowest = _optimum(tracks, fit, zooms, dispersion), held.cost
        if found.log_evidence + 0.5 * lowest / dispersion > math.log(FLOOR):
            # The way there may lead to another mode of the motion, which explains more tracks without zooms too.
            lowest = min(lowest, fit_window(tracks, found.fit.state, priors, max_steps=_ROUNDS * _STEPS).cost)
        yield replace(found, log_evidence=found.log_evidence + 0.5 * lowest / dispersion)


def _starts(
    hypotheses: WindowHypotheses, held: JointFit, rotation: ZoomingRotation
) -> Iterator[tuple[WindowTracks, JointFit, Floats]]:
    """The tracks as measured, a fit to them with zooms undone, and these zooms (V,)."""
    best = hypotheses.motions[0]
    yield best.tracks, held, np.zeros(len(best.rows))
    # Smaller zooms lead where the best motion leads.
    if not rotation.has_zooms or not rotation.explains_much(hypotheses):
        return
    found = look_again(rotation.hypotheses).motions[0]
    if hypotheses.planar:
        tracks = rotation.hypotheses.tracks
        on_plane = with_plane(found.motion, tracks, bearings_of_best(rotation.hypotheses))
        found = fit_motion(tracks, on_plane, hypotheses.priors)
    if found.rows == best.rows:
        zooms = rotation.zooms[list(best.rows)]
        # The fit has the shifts undone too.
        fit = _fitted(zoomed(best.tracks, zooms), found.fit.state, hypotheses.priors)
        yield best.tracks, fit, zooms


def _optimum(tracks: WindowTracks, fit: JointFit, zooms: Floats, dispersion: float) -> ZoomingMotion:
    """Fit the zooms and the motion in turn; the motion follows each step of the zooms as its expansion says."""
    covariances = [sigma**2 * zoom_covariance(tracks.times_s) for sigma in _ZOOM_SIGMAS]
    precision = np.asarray(np.linalg.inv(covariances[-1]), np.float64)

    def log_likelihood(fit: JointFit, zooms: Floats) -> float:
        return -0.5 * (fit.cost + float(zooms[1:] @ precision @ zooms[1:]))

    value, expanded = log_likelihood(fit, zooms), _Expansion.of(fit)
    for _ in range(_ROUNDS):
        step = expanded.step(zooms, precision)
        largest = float(np.abs(step).max())
        step *= min(1.0, _LONGEST_STEP / max(largest, _CONVERGED))
        gained = 0.0
        for _ in range(_TRIES if largest > _CONVERGED else 0):
            moved = (1 + zooms) * (1 + step) - 1
            fitted = _fitted(zoomed(tracks, moved), fit.state, fit.priors)
            gained = log_likelihood(fitted, moved) - value
            if gained > 0:
                fit, zooms, value = fitted, moved, value + gained
                expanded = _Expansion.of(fit)
                break
            step *= _SHORTER
        if gained < _LEAST_GAIN:
            break
    evidence = [-0.5 * fit.cost / dispersion + expanded.log_evidence(zooms, one, dispersion) for one in covariances]
    mean = float(np.logaddexp.reduce(evidence)) - math.log(len(evidence))
    return ZoomingMotion(fit, zooms, mean, expanded.direction_sigma_deg(precision))


def _fitted(tracks: WindowTracks, state: WindowState, priors: Priors) -> JointFit:
    """The fit from the motion and the lens of a state, with the rays as measured."""
    start = start_at(tracks, state.R, state.t, state.plane, lens=state.lens)
    return fit_window(tracks, start, priors, max_steps=_STEPS)


@dataclass(frozen=True, eq=False)
class _Expansion:
    """The quadratic expansion of the cost of a fit, with the zooms of all views but the first as its last unknowns."""

    fit: JointFit
    #: (X + V - 1, X + V - 1) and (X + V - 1,) Without a prior of the zooms.
    information: Floats
    gradient: Floats

    @staticmethod
    def of(fit: JointFit) -> _Expansion:
        """Expand a fit; the zooms are linear terms of error fields, which have no other part."""
        lin, views = linearize_with_fields(fit), len(fit.state.R)
        by_zoom = zooms_and_shifts(fit.tracks.camera, views)[:, ::3]
        chosen = np.zeros((len(lin.gradient), int((~lin.is_field).sum()) + views - 1))
        chosen[np.flatnonzero(~lin.is_field), np.arange(chosen.shape[1] - views + 1)] = 1.0
        chosen[lin.is_field, chosen.shape[1] - views + 1 :] = by_zoom
        information, gradient = chosen.T @ lin.information @ chosen, chosen.T @ lin.gradient
        gradient[1 - views :] += shrunk_noise(fit)
        return _Expansion(fit, information + 1e-9 * np.eye(len(gradient)), gradient)

    def step(self, zooms: Floats, precision: Floats) -> Floats:
        """The Gauss-Newton step (V,) of the zooms."""
        views, gradient = len(zooms), self.gradient.copy()
        gradient[1 - views :] += precision @ zooms[1:]
        step = -_solved(self._with(precision), gradient[:, None])[1 - views :, 0]
        return np.concatenate([[0.0], step])

    def log_evidence(self, zooms: Floats, covariance: Floats, dispersion: float) -> float:
        """What the prior of the zooms and their uncertainty add to the log likelihood of the fit."""
        own = len(self.gradient) - len(covariance)
        H = self.information
        left = H[own:, own:] - H[own:, :own] @ _solved(H[:own, :own], H[:own, own:])
        root = np.linalg.cholesky(covariance)
        told = np.linalg.eigvalsh(root.T @ (0.5 * (left + left.T)) @ root) / dispersion
        by_prior = float(zooms[1:] @ np.linalg.solve(covariance, zooms[1:]))
        return -0.5 * (by_prior + float(np.log1p(np.maximum(told, 0.0)).sum()))

    def direction_sigma_deg(self, precision: Floats) -> float:
        """Largest standard deviation of the direction of the pair, whatever the zooms are."""
        J = direction_derivatives(self.fit.state, len(self.gradient))[1][0]
        covariance = J @ _solved(self._with(precision), J.T)
        return math.degrees(math.sqrt(max(float(np.linalg.eigvalsh(0.5 * (covariance + covariance.T))[-1]), 0.0)))

    def _with(self, precision: Floats) -> Floats:
        information, own = self.information.copy(), len(self.gradient) - len(precision)
        information[own:, own:] += precision
        return information


def _solved(information: Floats, right: Floats) -> Floats:
    """Solve equations (N, N) whose unknowns have units that differ by many orders, for (N, M)."""
    units = np.sqrt(np.maximum(np.diag(information), 1e-300))
    return np.asarray(np.linalg.solve(information / np.outer(units, units), right / units[:, None]) / units[:, None])
