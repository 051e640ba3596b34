"""The joint fit of a window: one robust maximum-likelihood estimate of all views, for one hypothesis.

The hypothesis says whether most points lie on one plane, and where the fit starts. Unknown are the poses of all views
but the first, the true rays of all tracks, the inverse distances of the tracks off the plane, the lens (focal length,
distortion, readout and principal point, with priors), the plane, and for each view a smooth field of correlated errors
that its tracks have in common (with a prior). The length of one baseline is held, since images do not determine the
scale. Two views, three or twelve: the same code.

A track may leave the plane, at a fixed cost. So depth variation beside a plane is a part of the model, and a plane that
is none loses its tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from slam_init.types.arrays import Bools, Floats
from slam_init.window.arguments import Limits
from slam_init.window.equations import WindowEquations, explained_at_most
from slam_init.window.kernel import OFF_PLANE_COST
from slam_init.window.state import Priors, WindowState, start_at
from slam_init.window.tracks import WindowTracks

#: Of a fit that starts near the answer.
LIMITS = Limits()
#: How often the tracks may leave the plane or return to it before the fit ends.
_PLANE_ROUNDS = 2
#: Rays follow a step of the lens linearly. A distortion that moves by 0.1 leaves the rays of a wide image by several
#: pixels, beyond the outlier gate, from where no step brings them back. So they are measured again where the distortion
#: or the focal length moved by a hundredth, which leaves less than a twentieth of a pixel.
_LENS_TOLERANCE, _LENS_ROUNDS = 0.01, 3
#: The noise is measured again this often, each time with the outliers of the last value. Within three deviations a 2-D
#: Gaussian has this share of its variance.
_NOISE_ROUNDS, _INSIDE_THREE_SIGMAS = 5, 0.949
#: An observation is near its projection within this number of standard deviations: some pixels. Wrong matches lie
#: anywhere in the image; tracks on slowly moving objects stay near.
#: Class: assumption.
NEAR_SIGMAS = 30.0
#: Median of the squared length of a 2-D Gaussian of variance 1, and the largest noise at a start over the assumed one.
_MEDIAN_SQUARE, _LARGEST_START_FACTOR = 1.386, 30.0


@dataclass(frozen=True, eq=False)
class JointFit:
    """A fitted window."""

    tracks: WindowTracks
    priors: Priors
    #: Whether all points are at infinity.
    rotation_only: bool
    state: WindowState
    #: Twice the negative logarithm of the posterior density, up to a constant.
    cost: float
    #: (T,) The share of each track in the cost, with the cost of leaving the plane.
    track_costs: Floats
    #: Number of Gauss-Newton steps.
    iterations: int
    #: View whose baseline was held.
    held_view: int
    #: (V, T, 2) Of each observation in units of the noise; infinite behind a camera.
    residuals: Floats
    #: (T,) Tracks that the fit explains.
    explains: Bools
    #: (T,) Tracks that it does not explain although they stay near their projections.
    close_outliers: Bools
    #: Whether it was given up, since it could not reach the cost that was asked for.
    given_up: bool

    @property
    def explained(self) -> int:
        """Number of tracks that the fit explains."""
        return int(self.explains.sum())

    @property
    def information(self) -> Floats:
        """Of the unknowns of the views, the lens and the plane, tracks eliminated, baseline held.

        Shapes: returns (G, G), in the order of :mod:`slam_init.window.kernel`.
        """
        return self._at_end.information(self.state)

    @cached_property
    def dispersion(self) -> float:
        """How much the cost of a track falls by chance where its point may move in one direction, at least 1.

        1 for errors that are independent from view to view, more for a tracker that keeps its errors. It is measured
        across the epipolar lines, where a rigid scene does not move.
        """
        equations = self._at_end
        free = equations.free & ~self.state.on_plane & (self.tracks.anchor >= 0)
        return max(float(equations.across[free].mean()), 1.0) if free.any() else 1.0

    @cached_property
    def noise_factor(self) -> float:
        """The noise by the residuals over the noise of the tracks as assumed; 1 where there are too few residuals.

        Residuals beyond three deviations are outliers.
        """
        used = self.tracks.seen & (self.tracks.anchor >= 0)
        poses, factor2 = 6 * (len(used) - 1), 1.0
        squares = np.einsum("vtq,vtq->vt", self.residuals, self.residuals)
        for _ in range(_NOISE_ROUNDS):
            inside = used & (squares < 9.0 * factor2)
            observations, counts = float(inside.sum()), inside.sum(axis=0)
            free = (counts >= 2) & ~self.state.on_plane & self._at_end.free
            freedom = 2 * observations - 2 * float((counts >= 1).sum()) - float(free.sum()) - poses
            if freedom < 0.1 * observations:
                return 1.0
            factor2 = float(squares[inside].sum()) / (freedom * _INSIDE_THREE_SIGMAS)
        return float(np.sqrt(factor2))

    @cached_property
    def _at_end(self) -> WindowEquations:
        """The equations at the fitted state: they take as long as a step, and most fits only compete by their cost."""
        equations = WindowEquations(self.tracks, self.state, self.priors, self.rotation_only)
        equations.held_view = self.held_view
        equations.build(self.state)
        return equations


def fit_window(
    tracks: WindowTracks,
    start: WindowState,
    priors: Priors,
    *,
    known: WindowState | None = None,
    rotation_only: bool = False,
    limits: Limits = LIMITS,
) -> JointFit:
    """Fit all views of a window jointly, from a start near the answer.

    * ``start``: Its plane says whether the points lie on a plane. The length of the longest baseline from view 0 is
      held.
    * ``known``: The start with the points of an earlier fit. A track starts where it costs less: of 200 simulated
      worlds before flat ground with four poles four had a false map without these.
    * ``rotation_only``: Whether all points are at infinity, so that the camera only rotates.
    """
    equations = WindowEquations(tracks, start, priors, rotation_only)
    if known is not None:
        equations.cost(start)
        of_start = equations.costs.copy()
        equations.cost(known)
        start = start.with_points_of(known, equations.costs <= of_start)
    fit = _optimized(equations, start, limits)
    if fit.given_up:
        return fit
    lens = start.lens
    for _ in range(_LENS_ROUNDS):
        moved = fit.state.lens
        if max(abs(moved.k1 - lens.k1), abs(moved.log_scale - lens.log_scale)) < _LENS_TOLERANCE:
            break
        lens, again = moved, _measured_again(equations, fit)
        if again is None:
            break
        fit = _optimized(equations, again, limits)
    for _ in range(0 if start.plane is None else _PLANE_ROUNDS):
        reassigned = _reassigned(equations, fit.state)
        if (reassigned.on_plane == fit.state.on_plane).all():
            break
        fit = _optimized(equations, reassigned, limits)
    return fit


def start_noise_factor(
    tracks: WindowTracks, start: WindowState, priors: Priors, *, rotation_only: bool = False
) -> float:
    """The noise of a start over the noise of its tracks, by the median residual.

    A start is off by more than the noise, and the noise of a pair can be far smaller than that of the other views. With
    too small a noise all observations count as outliers, and the fit cannot move.
    """
    equations = WindowEquations(tracks, start, priors, rotation_only)
    equations.build(start)
    equations.cost(equations.moved(start, np.zeros(len(equations.gradient))))
    used = tracks.seen & (tracks.anchor >= 0)
    median = float(np.median(equations.squares[used])) if used.any() else 0.0
    return float(np.sqrt(min(max(median / _MEDIAN_SQUARE, 1.0), _LARGEST_START_FACTOR**2)))


def costs_off_plane(fit: JointFit) -> Floats:
    """The cost of each track of a fit, at the same poses, if each point had a distance of its own.

    Shapes: returns (T,).

    * Returns: Without the cost of leaving the plane. The rays and the distances are those of one Gauss-Newton step.
    """
    state = fit.state
    equations = WindowEquations(fit.tracks, state, fit.priors)
    return _costs_off_plane(equations, state, _measured(fit.tracks, state))


def _optimized(equations: WindowEquations, state: WindowState, limits: Limits) -> JointFit:
    """Levenberg-Marquardt from a state."""
    state, cost, steps, given_up = equations.optimized(state, limits)
    return JointFit(
        equations.tracks,
        equations.priors,
        equations.rotation_only,
        state,
        cost,
        equations.costs.copy(),
        steps,
        equations.held_view,
        equations.residuals.copy(),
        *_explained_and_near(equations, state),
        given_up,
    )


def _explained_and_near(equations: WindowEquations, state: WindowState) -> tuple[Bools, Bools]:
    seen, used = equations.tracks.seen, equations.tracks.anchor >= 0
    bound = explained_at_most(np.maximum(2 * seen.sum(axis=0) - 3, 0)) + OFF_PLANE_COST * (state.plane is not None)
    explained = used & (equations.costs <= bound)
    near = (seen & (equations.squares < NEAR_SIGMAS**2)).sum(axis=0) > 0.5 * seen.sum(axis=0)
    return explained, used & ~explained & near


def _reassigned(equations: WindowEquations, state: WindowState) -> WindowState:
    """The tracks on the plane and those off it, by their costs at the poses of a state."""
    equations.cost(replace(state, on_plane=np.ones(len(state.rays), bool)))
    on = equations.costs.copy()
    measured = _measured(equations.tracks, state)
    off = _costs_off_plane(equations, state, measured) + OFF_PLANE_COST
    return replace(state, on_plane=on <= off, inverse_distances=measured.inverse_distances)


def _measured_again(equations: WindowEquations, fit: JointFit) -> WindowState | None:
    """The state of a fit with the rays as measured by its lens, for tracks that cost less so; None if none does."""
    measured = _measured(equations.tracks, fit.state, at_infinity=equations.rotation_only)
    again = replace(fit.state, rays=measured.rays, inverse_distances=measured.inverse_distances)
    equations.cost(again)
    better = equations.costs < fit.track_costs
    return fit.state.with_points_of(again, better) if better.any() else None


def _measured(tracks: WindowTracks, state: WindowState, *, at_infinity: bool = False) -> WindowState:
    """The same poses and camera, with the rays as measured and a distance for each."""
    return start_at(tracks, state.R, state.t, lens=state.lens, at_infinity=at_infinity)


def _costs_off_plane(equations: WindowEquations, state: WindowState, measured: WindowState) -> Floats:
    """The cost of each track with a distance of its own, from its ray as measured or as fitted with the plane."""
    nowhere = np.zeros(len(state.rays), bool)
    best = np.full(len(state.rays), np.inf)
    for rays in (state.rays, measured.rays):
        start = replace(state, on_plane=nowhere, inverse_distances=measured.inverse_distances, rays=rays)
        equations.build(start)
        for moved in (start, equations.moved(start, np.zeros(len(equations.gradient)))):
            equations.cost(moved)
            best = np.minimum(best, equations.costs)
    leaves_plane = (equations.tracks.anchor >= 0) & (state.plane is not None)
    return np.asarray(best - OFF_PLANE_COST * leaves_plane)
