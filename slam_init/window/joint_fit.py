"""The joint fit of a window: one robust maximum-likelihood estimate of all views, for one hypothesis.

The hypothesis says whether most points lie on one plane, and where the fit starts. Unknown are the poses of all views
but the first, the true rays of all tracks, the inverse distances of the tracks off the plane, the focal length (with a
prior), the plane, and for each view a smooth error field that its tracks have in common (with a prior). The length of
one baseline is held, since images do not tell the scale. Two views, three or twelve: the same code.

A track may leave the plane, at a fixed cost. So relief beside a plane is a part of the model, and a plane that is none
loses its tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.window.kernels import FIELD_TERMS, accumulate, eliminate
from slam_init.window.projection import camera_vector
from slam_init.window.tracks import WindowTracks

__all__ = [
    "OFF_PLANE_COST",
    "JointFit",
    "Linearization",
    "Priors",
    "WindowState",
    "costs_off_plane",
    "fit_window",
    "linearize_with_fields",
    "start_at",
    "start_noise_factor",
]

#: Levenberg-Marquardt: first damping, the factor of a rejected step, and how often a step is tried.
_DAMPING, _RAISE, _TRIES = 1e-4, 10.0, 6
#: Cost of a track that leaves the plane: three nats, as much as a track may vote for or against a hypothesis.
OFF_PLANE_COST = 6.0
#: How often the tracks may leave the plane or return to it before the fit ends.
_PLANE_ROUNDS = 2
#: The noise is measured again this often, each time with the outliers of the last value. Within three deviations a 2-D
#: Gaussian has this share of its variance.
_NOISE_ROUNDS, _INSIDE_THREE_SIGMAS = 5, 0.949
#: Median of the squared length of a 2-D Gaussian of variance 1, and the largest noise at a start over the assumed one.
_MEDIAN_SQUARE, _LARGEST_START_FACTOR = 1.386, 30.0
#: Stiffness of the held baseline over that of its view.
_GAUGE = 1e4


@dataclass(frozen=True)
class Priors:
    """What is known before the fit.

    Attributes
    ----------
    focal_sigma : float
        Relative standard deviation of the stated focal length.
    field_sigma_px : float
        Standard deviation of each coefficient of the error field of a view, in pixels; 0 for no field.
    gate_sigmas : float
        An observation counts as an outlier around this number of standard deviations.
    """

    focal_sigma: float = 0.02
    field_sigma_px: float = 0.0
    gate_sigmas: float = 3.0


@dataclass(frozen=True, eq=False)
class WindowState:
    """The unknowns of a fit.

    Attributes
    ----------
    R, t : (V, 3, 3), (V, 3) float
        cam_from_world; the world is the frame of view 0.
    rays : (T, 3) float
        True unit rays in the anchor views.
    inverse_distances : (T,) float
        Along the rays, not negative; not used on the plane.
    log_scale : float
        Logarithm of the true focal length over the stated one.
    field : (V, 12) float
        Coefficients of the error fields.
    plane : (3,) float or None
        ``plane . X = 1`` in the world; None without one.
    on_plane : (T,) bool
        Tracks whose point lies on the plane.
    """

    R: Floats
    t: Floats
    rays: Floats
    inverse_distances: Floats
    log_scale: float
    field: Floats
    plane: Floats | None
    on_plane: Bools


@dataclass(frozen=True, eq=False)
class JointFit:
    """A fitted window.

    Attributes
    ----------
    state : WindowState
    cost : float
        Twice the negative logarithm of the posterior density, up to a constant.
    track_costs : (T,) float
        The share of each track in the cost, with the cost of leaving the plane.
    iterations : int
        Number of Gauss-Newton steps.
    information : (G, G) float
        Of the unknowns of the views, the focal length and the plane, tracks eliminated, baseline held; in the order of
        :mod:`slam_init.window.kernels`.
    held_view : int
        View whose baseline was held.
    noise_factor : float
        The noise by the residuals over the noise of the tracks as assumed; 1 where there are too few residuals.
    dispersion : float
        How much the cost of a track falls by chance where its point may move in one direction, at least 1: 1 for errors
        that are independent from view to view, more for a tracker that keeps its errors. It is measured across the
        epipolar lines, where a rigid scene does not move.
    field_size : int
        Number of coefficients of the error field of a view in the information; 0 where there is none.
    """

    state: WindowState
    cost: float
    track_costs: Floats
    iterations: int
    information: Floats
    held_view: int
    noise_factor: float
    dispersion: float
    field_size: int = 0

    def pose_covariance(self, view: int) -> Floats:
        """Covariance of cam_from_world of a view (rotation vector from the left, translation), by Laplace.

        Parameters
        ----------
        view : int
            From 1.

        Returns
        -------
        (6, 6) float
        """
        first = self.field_size + (6 + self.field_size) * (view - 1)
        columns = np.linalg.solve(self.information, np.eye(len(self.information))[:, first : first + 6])
        return np.asarray(columns[first : first + 6])


def start_at(
    tracks: WindowTracks,
    R: Floats,
    t: Floats,
    plane: Floats | None = None,
    *,
    log_scale: float = 0.0,
    at_infinity: bool = False,
) -> WindowState:
    """A state at given poses: measured rays, and inverse distances by linear least squares.

    Parameters
    ----------
    tracks : WindowTracks
    R, t : (V, 3, 3), (V, 3) float
        cam_from_world.
    plane : (3,) float, optional
        All points start on it.
    log_scale : float
        Logarithm of the true focal length over the stated one.
    at_infinity : bool
        Whether all points start at infinity.

    Returns
    -------
    WindowState
    """
    anchor = np.maximum(tracks.anchor, 0)
    bearings = tracks.bearings(log_scale)
    rays = bearings[anchor, np.arange(len(anchor))]
    rays = np.where(np.isfinite(rays), rays, tracks.rays)
    world = np.einsum("tji,tj->ti", R[anchor], rays)
    centre = np.einsum("tji,tj->ti", R[anchor], t[anchor])
    numerator, denominator = np.zeros(len(anchor)), np.full(len(anchor), 1e-12)
    for k in range(len(R)):
        measured = bearings[k]
        along, by_depth = world @ R[k].T, t[k] - centre @ R[k].T
        # n x (along + rho by_depth) = 0
        a, b = np.cross(measured, along), np.cross(measured, by_depth)
        used = tracks.seen[k] & (anchor != k) & np.isfinite(measured).all(axis=1)
        numerator -= np.where(used, np.einsum("ij,ij->i", a, b), 0.0)
        denominator += np.where(used, np.einsum("ij,ij->i", b, b), 0.0)
    inverse = np.maximum(np.nan_to_num(numerator / denominator), 0.0) * (not at_infinity)
    field, on_plane = np.zeros((len(R), FIELD_TERMS)), np.full(len(anchor), plane is not None)
    return WindowState(R.copy(), t.copy(), rays, inverse, log_scale, field, plane, on_plane)


def fit_window(
    tracks: WindowTracks,
    start: WindowState,
    priors: Priors,
    *,
    rotation_only: bool = False,
    max_steps: int = 12,
    tolerance: float = 0.05,
) -> JointFit:
    """Fit all views of a window jointly, from a start near the answer.

    Parameters
    ----------
    tracks : WindowTracks
    start : WindowState
        Its plane says whether the points lie on a plane. The length of the longest baseline from view 0 is held.
    priors : Priors
    rotation_only : bool
        Whether all points are at infinity, so that the camera only rotates.
    max_steps : int
        Largest number of Gauss-Newton steps.
    tolerance : float
        The fit ends where a step lowers the cost by less: a fortieth of a nat is far below what decides.

    Returns
    -------
    JointFit
    """
    fitter = _Fitter(tracks, start, priors, rotation_only)
    fit = fitter.run(start, max_steps, tolerance)
    for _ in range(0 if start.plane is None else _PLANE_ROUNDS):
        reassigned = fitter.reassigned(fit.state)
        if (reassigned.on_plane == fit.state.on_plane).all():
            break
        fit = fitter.run(reassigned, max_steps, tolerance)
    return fit


def start_noise_factor(
    tracks: WindowTracks, start: WindowState, priors: Priors, *, rotation_only: bool = False
) -> float:
    """The noise of a start over the noise of its tracks, by the median residual.

    A start is off by more than the noise, and the noise of a pair can be far smaller than that of the other views. With
    too small a noise all observations count as outliers, and the fit cannot move.

    Parameters
    ----------
    tracks : WindowTracks
    start : WindowState
    priors : Priors
    rotation_only : bool
        Whether all points are at infinity.

    Returns
    -------
    float
        From 1 to 30.
    """
    return _Fitter(tracks, start, priors, rotation_only).start_noise_factor(start)


def costs_off_plane(tracks: WindowTracks, fit: JointFit, priors: Priors) -> Floats:
    """The cost of each track of a fit, at the same poses, if each point had a distance of its own.

    Parameters
    ----------
    tracks : WindowTracks
        As fitted.
    fit : JointFit
        With a plane.
    priors : Priors
        As fitted.

    Returns
    -------
    (T,) float
        Without the cost of leaving the plane. The rays and the distances are those of one Gauss-Newton step.
    """
    return _Fitter(tracks, fit.state, priors, False).off_plane(fit.state)


@dataclass(frozen=True, eq=False)
class Linearization:
    """The quadratic expansion of the cost about a fit, with an error field in each view that has no prior yet.

    Attributes
    ----------
    information, gradient : (G, G), (G,) float
        Half of the second and half of the first derivatives of the cost, tracks eliminated, baseline held.
    shares : (T, G) float
        The share of each track in the gradient.
    is_field : (G,) bool
        Which unknowns are coefficients of the fields. The others have the order of :attr:`JointFit.information`.
    distance_variance : (T,) float
        Variance of the inverse distance of each track off the plane, if all other unknowns were known.
    distance_coupling : (T, G) float
        How the inverse distance of each track follows the other unknowns.
    """

    information: Floats
    gradient: Floats
    shares: Floats
    is_field: Bools
    distance_variance: Floats
    distance_coupling: Floats


def linearize_with_fields(
    tracks: WindowTracks, fit: JointFit, priors: Priors, *, rotation_only: bool = False
) -> Linearization:
    """Expand the cost of a fit in all its unknowns and in the error fields of the views.

    The distances of tracks at infinity count as unknowns too: that a distance is not negative bounds it on one side
    only. Their gradient, which the bound stops, is left out.

    Parameters
    ----------
    tracks : WindowTracks
        As fitted.
    fit : JointFit
        Without fields.
    priors : Priors
        The fields have no prior here.
    rotation_only : bool
        As fitted.

    Returns
    -------
    Linearization
    """
    return _Fitter(tracks, fit.state, replace(priors, field_sigma_px=np.inf), rotation_only).linearized(fit.state)


class _Fitter:
    """Levenberg-Marquardt with eliminated tracks; holds the arrays that the steps share."""

    def __init__(self, tracks: WindowTracks, start: WindowState, priors: Priors, rotation_only: bool) -> None:
        self._tracks, self._priors, self._rotation_only = tracks, priors, rotation_only
        self._camera = camera_vector(tracks.camera)
        self._has_plane = start.plane is not None
        self._field_size = FIELD_TERMS if priors.field_sigma_px > 0 else 0
        views, count = tracks.seen.shape
        self._views = views
        self._block = 6 + self._field_size
        self._focal = self._block * (views - 1) + self._field_size
        size = self._focal + 1 + (3 if self._has_plane else 0)
        self._normal, self._gradient, self._shares = np.zeros((size, size)), np.zeros(size), np.zeros((count, size))
        self._back, self._costs = np.zeros((count, 3, 4 + size)), np.zeros(count)
        self._squares, self._across = np.zeros((views, count)), np.zeros(count)
        firsts = self._field_size + self._block * np.arange(views - 1)
        self._pose_columns = firsts[:, None] + np.arange(6)
        self._held_view = int(np.argmax(np.linalg.norm(start.t, axis=1)))
        self._free = np.ones(count, bool)

    def run(self, state: WindowState, max_steps: int, tolerance: float) -> JointFit:
        cost = self._equations(state)
        damping, steps = _DAMPING, 0
        for _ in range(max_steps):
            normal, gradient = self._gauged(state), self._gradient.copy()
            diagonal = np.maximum(np.diag(normal), 1e-6)
            for _ in range(_TRIES):
                step = np.asarray(-np.linalg.solve(normal + damping * np.diag(diagonal), gradient), np.float64)
                moved = self._moved(state, step)
                lower = self._cost(moved)
                if lower < cost:
                    break
                damping *= _RAISE
            else:
                # The costs of the tracks are those of the last try, which was rejected.
                self._equations(state)
                break
            steps += 1
            settled = cost - lower < tolerance
            state, cost, damping = moved, lower, max(damping / _RAISE, 1e-9)
            self._equations(state)
            if settled:
                break
        return JointFit(
            state,
            cost,
            self._costs.copy(),
            steps,
            self._gauged(state),
            self._held_view,
            self._noise_factor(state),
            self._dispersion(state),
            self._field_size,
        )

    def _dispersion(self, state: WindowState) -> float:
        free = self._free & ~state.on_plane & (self._tracks.anchor >= 0)
        return max(float(self._across[free].mean()), 1.0) if free.any() else 1.0

    def start_noise_factor(self, state: WindowState) -> float:
        """The noise by the median residual at a start over the assumed noise, at least 1."""
        self._equations(state)
        self._cost(self._moved(state, np.zeros(len(self._gradient))))
        used = self._tracks.seen & (self._tracks.anchor >= 0)
        median = float(np.median(self._squares[used])) if used.any() else 0.0
        return float(np.sqrt(min(max(median / _MEDIAN_SQUARE, 1.0), _LARGEST_START_FACTOR**2)))

    def _noise_factor(self, state: WindowState) -> float:
        """The noise by the residuals over the assumed noise; residuals beyond three deviations are outliers."""
        used = self._tracks.seen & (self._tracks.anchor >= 0)
        factor2 = 1.0
        for _ in range(_NOISE_ROUNDS):
            inside = used & (self._squares < 9.0 * factor2)
            observations, counts = float(inside.sum()), inside.sum(axis=0)
            free = (counts >= 2) & ~state.on_plane & self._free
            freedom = 2 * observations - 2 * float((counts >= 1).sum()) - float(free.sum()) - 6 * (self._views - 1)
            if freedom < 0.1 * observations:
                return 1.0
            factor2 = float(self._squares[inside].sum()) / (freedom * _INSIDE_THREE_SIGMAS)
        return float(np.sqrt(factor2))

    def reassigned(self, state: WindowState) -> WindowState:
        """The tracks on the plane and those off it, by their costs at the poses of a state."""
        everywhere = np.ones(len(state.rays), bool)
        self._cost(replace(state, on_plane=everywhere))
        on = self._costs.copy()
        measured = start_at(self._tracks, state.R, state.t, log_scale=state.log_scale)
        off = self._off_plane(state, measured) + OFF_PLANE_COST
        return replace(state, on_plane=on <= off, inverse_distances=measured.inverse_distances)

    def off_plane(self, state: WindowState) -> Floats:
        """The cost of each track with a distance of its own."""
        return self._off_plane(state, start_at(self._tracks, state.R, state.t, log_scale=state.log_scale))

    def _off_plane(self, state: WindowState, measured: WindowState) -> Floats:
        nowhere = np.zeros(len(state.rays), bool)
        inverse = measured.inverse_distances
        # Rays as measured and as fitted with the plane; each track takes the better one.
        starts = [
            replace(state, on_plane=nowhere, inverse_distances=inverse, rays=rays)
            for rays in (state.rays, measured.rays)
        ]
        best = np.full(len(state.rays), np.inf)
        for start in starts:
            self._equations(start)
            for moved in (start, self._moved(start, np.zeros(len(self._gradient)))):
                self._cost(moved)
                best = np.minimum(best, self._costs)
        return np.asarray(best - (OFF_PLANE_COST if self._has_plane else 0.0) * (self._tracks.anchor >= 0))

    def linearized(self, state: WindowState) -> Linearization:
        self._free[:] = not self._rotation_only
        self._accumulate(state, fill=True)
        held = ~state.on_plane & (state.inverse_distances == 0) & (self._back[:, 2, 0] > 0)
        if held.any() and not self._rotation_only:
            # The equations are linear in the gradients of the tracks.
            stopped = self._back[held, :, 3] * self._back[held, 2, :1]
            self._shares[held] += np.einsum("tpg,tp->tg", self._back[held, :, 4:], stopped)
        is_field = np.zeros(len(self._gradient), bool)
        for k in range(self._views):
            is_field[self._field_columns(k)] = True
        shares, gradient = self._shares.copy(), self._shares.sum(axis=0)
        gradient[self._focal] += state.log_scale / self._priors.focal_sigma**2
        variance = self._back[:, 2, 3].copy()
        coupling = -np.einsum("tq,tqg->tg", self._back[:, 2, 1:4], self._back[:, :, 4:])
        on_plane = np.flatnonzero(state.on_plane & (self._tracks.anchor == 0))
        if state.plane is not None:
            # In the reference, the inverse distance along a ray is the product of the plane and the ray.
            variance[on_plane] = 0.0
            coupling[on_plane] = 0.0
            coupling[on_plane, -3:] = state.rays[on_plane]
        return Linearization(self._gauged(state), gradient, shares, is_field, variance, coupling)

    def _cost(self, state: WindowState) -> float:
        return self._accumulate(state, fill=False)

    def _equations(self, state: WindowState) -> float:
        """The equations of a step. Tracks at infinity whose distance would become negative are held there."""
        self._free[:] = not self._rotation_only
        cost = self._accumulate(state, fill=True)
        if not self._rotation_only:
            held = ~state.on_plane & (state.inverse_distances == 0) & (self._back[:, 2, 0] > 0)
            if held.any():
                self._free[held] = False
                cost = self._accumulate(state, fill=True)
        return cost

    def _accumulate(self, state: WindowState, *, fill: bool) -> float:
        tracks, priors = self._tracks, self._priors
        plane = np.zeros(3) if state.plane is None else state.plane
        cost = accumulate(
            self._camera, state.R, state.t, state.log_scale, plane, state.on_plane, state.field, self._field_size,
            tracks.pixels, tracks.sigma_px, tracks.places, tracks.seen, tracks.anchor, state.rays,
            state.inverse_distances, self._free, priors.gate_sigmas**2, self._normal, self._shares, self._back,
            self._costs, self._squares, self._across, fill,
        )  # fmt: skip
        if self._has_plane:
            off = ~state.on_plane & (tracks.anchor >= 0)
            self._costs[off] += OFF_PLANE_COST
            cost += OFF_PLANE_COST * float(off.sum())
        cost += (state.log_scale / priors.focal_sigma) ** 2
        if fill:
            self._gradient[:] = eliminate(self._normal, self._shares, self._back)
            self._normal[self._focal, self._focal] += 1 / priors.focal_sigma**2
            self._gradient[self._focal] += state.log_scale / priors.focal_sigma**2
        if self._field_size:
            cost += float(np.sum(state.field**2)) / priors.field_sigma_px**2
            for k in range(self._views if fill else 0):
                own = self._field_columns(k)
                self._normal[own, own] += 1 / priors.field_sigma_px**2
                self._gradient[own] += state.field[k] / priors.field_sigma_px**2
        return cost

    def _field_columns(self, view: int) -> Ints:
        first = self._field_size + self._block * (view - 1) + 6 if view else 0
        return np.arange(first, first + self._field_size)

    def _gauged(self, state: WindowState) -> Floats:
        """The information with the length of one baseline held."""
        normal = self._normal.copy()
        first = self._field_size + self._block * (self._held_view - 1) + 3
        own = slice(first, first + 3)
        along = state.t[self._held_view] / max(float(np.linalg.norm(state.t[self._held_view])), 1e-300)
        normal[own, own] += _GAUGE * max(1.0, float(np.trace(normal[own, own]))) * np.outer(along, along)
        return normal

    def _moved(self, state: WindowState, step: Floats) -> WindowState:
        R, t, field = state.R.copy(), state.t.copy(), state.field.copy()
        poses = step[self._pose_columns]
        R[1:] = _rotations(poses[:, :3]) @ R[1:]
        t[1:] += poses[:, 3:]
        if self._field_size:
            for k in range(self._views):
                field[k] += step[self._field_columns(k)]
        local: Floats = self._back[:, :, 0] + self._back[:, :, 4:] @ step
        local = -np.einsum("tpq,tq->tp", self._back[:, :, 1:4], local)
        first_tangent, second_tangent = _tangents(state.rays)
        rays = state.rays + first_tangent * local[:, :1] + second_tangent * local[:, 1:2]
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
        free = self._free & ~state.on_plane
        inverse = np.maximum(state.inverse_distances + np.where(free, local[:, 2], 0.0), 0.0)
        plane = None if state.plane is None else state.plane + step[-3:]
        return replace(
            state,
            R=R,
            t=t,
            rays=rays,
            inverse_distances=inverse,
            log_scale=state.log_scale + float(step[self._focal]),
            field=field,
            plane=plane,
        )


def _rotations(vectors: Floats) -> Floats:
    """Rotation matrices (V, 3, 3) of rotation vectors (V, 3): the formula of Rodrigues."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    x, y, z = vectors.T
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
    cross[:, 1, 0], cross[:, 2, 0], cross[:, 2, 1] = z, -y, x
    sine, versine = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))


def _tangents(rays: Floats) -> tuple[Floats, Floats]:
    """Two orthonormal vectors (T, 3) orthogonal to each ray, as :func:`quest.robust.kernels.small_algebra.tangents`."""
    x, y, z = rays.T
    none = np.zeros_like(x)
    smallest = np.argmin(np.abs(rays), axis=1)
    first = np.where(
        (smallest == 0)[:, None],
        np.stack([none, z, -y], axis=1),
        np.where((smallest == 1)[:, None], np.stack([-z, none, x], axis=1), np.stack([y, -x, none], axis=1)),
    )
    first = first / np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    return first, np.cross(rays, first)
