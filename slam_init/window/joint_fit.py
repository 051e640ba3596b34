"""The joint fit of a window: one robust maximum-likelihood estimate of all views, for one hypothesis.

The hypothesis says what the points are (free, or on one plane) and where the fit starts. Unknown are the poses of all
views but the first, the true rays and inverse distances of all tracks, the focal length (with a prior), the plane, and
for each view a smooth error field that its tracks have in common (with a prior). The length of one baseline is held,
since images do not tell the scale. Two views, three or twelve: the same code.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Floats, Ints
from slam_init.window.kernels import FIELD_TERMS, accumulate
from slam_init.window.projection import camera_vector
from slam_init.window.tracks import WindowTracks

__all__ = ["JointFit", "Priors", "WindowState", "fit_window", "start_at", "with_error_fields"]

#: Levenberg-Marquardt: first damping, the factor of a rejected step, and how often a step is tried.
_DAMPING, _RAISE, _TRIES = 1e-4, 10.0, 6
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
        Along the rays, not negative; not used on a plane.
    log_scale : float
        Logarithm of the true focal length over the stated one.
    field : (V, 12) float
        Coefficients of the error fields.
    plane : (3,) float or None
        ``plane . X = 1`` in the world; None for free points.
    """

    R: Floats
    t: Floats
    rays: Floats
    inverse_distances: Floats
    log_scale: float
    field: Floats
    plane: Floats | None = None


@dataclass(frozen=True, eq=False)
class JointFit:
    """A fitted window.

    Attributes
    ----------
    state : WindowState
    cost : float
        Twice the negative logarithm of the posterior density, up to a constant.
    track_costs : (T,) float
        The share of each track in the cost.
    iterations : int
        Number of Gauss-Newton steps.
    information : (G, G) float
        Of the unknowns of the views, the focal length and the plane, tracks eliminated, baseline held; in the order of
        :mod:`slam_init.window.kernels`.
    held_view : int
        View whose baseline was held.
    field_size : int
        Number of coefficients of the error field of a view in the information; 0 where there is none.
    """

    state: WindowState
    cost: float
    track_costs: Floats
    iterations: int
    information: Floats
    held_view: int

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
    tracks: WindowTracks, R: Floats, t: Floats, plane: Floats | None = None, *, at_infinity: bool = False
) -> WindowState:
    """A state at given poses: measured rays, and inverse distances by linear least squares.

    Parameters
    ----------
    tracks : WindowTracks
    R, t : (V, 3, 3), (V, 3) float
        cam_from_world.
    plane : (3,) float, optional
        For points on a plane.
    at_infinity : bool
        Whether all points start at infinity.

    Returns
    -------
    WindowState
    """
    anchor = np.maximum(tracks.anchor, 0)
    world = np.einsum("tji,tj->ti", R[anchor], tracks.rays)
    centre = np.einsum("tji,tj->ti", R[anchor], t[anchor])
    numerator, denominator = np.zeros(len(anchor)), np.full(len(anchor), 1e-12)
    for k in range(len(R)):
        measured = tracks.camera.bearings(tracks.pixels[k])
        along, by_depth = world @ R[k].T, t[k] - centre @ R[k].T
        # n x (along + rho by_depth) = 0
        a, b = np.cross(measured, along), np.cross(measured, by_depth)
        used = tracks.seen[k] & (anchor != k) & np.isfinite(measured).all(axis=1)
        numerator -= np.where(used, np.einsum("ij,ij->i", a, b), 0.0)
        denominator += np.where(used, np.einsum("ij,ij->i", b, b), 0.0)
    inverse = np.maximum(np.nan_to_num(numerator / denominator), 0.0) * (not at_infinity)
    return WindowState(R.copy(), t.copy(), tracks.rays.copy(), inverse, 0.0, np.zeros((len(R), FIELD_TERMS)), plane)


def fit_window(
    tracks: WindowTracks,
    start: WindowState,
    priors: Priors,
    *,
    rotation_only: bool = False,
    max_steps: int = 20,
    tolerance: float = 0.01,
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
        The fit ends where a step lowers the cost by less: a hundredth is far below what decides.

    Returns
    -------
    JointFit
    """
    fitter = _Fitter(tracks, start, priors, rotation_only)
    return fitter.run(start, max_steps, tolerance)


def with_error_fields(tracks: WindowTracks, fit: JointFit, priors: Priors) -> JointFit:
    """The same fit, with the information that remains when each view has an unknown error field.

    The fields make a step several times as expensive (see ``benchmarks/measured/window_fit.md``). So a window is fitted
    without them, and they enter the covariance only.

    Parameters
    ----------
    tracks : WindowTracks
        As fitted.
    fit : JointFit
        Without fields.
    priors : Priors
        With the standard deviation of the fields.

    Returns
    -------
    JointFit
    """
    return _Fitter(tracks, fit.state, priors, False).linearized(fit)


class _Fitter:
    """Levenberg-Marquardt with eliminated tracks; holds the arrays that the steps share."""

    def __init__(self, tracks: WindowTracks, start: WindowState, priors: Priors, rotation_only: bool) -> None:
        self._tracks, self._priors, self._rotation_only = tracks, priors, rotation_only
        self._camera = camera_vector(tracks.camera)
        self._is_plane = start.plane is not None
        self._field_size = FIELD_TERMS if priors.field_sigma_px > 0 else 0
        views, count = tracks.seen.shape
        self._views = views
        self._block = 6 + self._field_size
        self._focal = self._block * (views - 1) + self._field_size
        size = self._focal + 1 + (3 if self._is_plane else 0)
        self._normal, self._gradient = np.zeros((size, size)), np.zeros(size)
        self._back, self._costs = np.zeros((count, 3, 4 + size)), np.zeros(count)
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
                break
            steps += 1
            settled = cost - lower < tolerance
            state, cost, damping = moved, lower, max(damping / _RAISE, 1e-9)
            self._equations(state)
            if settled:
                break
        return JointFit(state, cost, self._costs.copy(), steps, self._gauged(state), self._held_view, self._field_size)

    def linearized(self, fit: JointFit) -> JointFit:
        self._equations(fit.state)
        return replace(fit, information=self._gauged(fit.state), field_size=self._field_size)

    def _cost(self, state: WindowState) -> float:
        return self._accumulate(state, fill=False)

    def _equations(self, state: WindowState) -> float:
        """The equations of a step. Tracks at infinity whose distance would become negative are held there."""
        self._free[:] = not self._rotation_only
        cost = self._accumulate(state, fill=True)
        if not self._is_plane and not self._rotation_only:
            held = (state.inverse_distances == 0) & (self._back[:, 2, 0] > 0)
            if held.any():
                self._free[held] = False
                cost = self._accumulate(state, fill=True)
        return cost

    def _accumulate(self, state: WindowState, *, fill: bool) -> float:
        tracks, priors = self._tracks, self._priors
        plane = np.zeros(3) if state.plane is None else state.plane
        cost = accumulate(
            self._camera, state.R, state.t, state.log_scale, plane, self._is_plane, state.field, self._field_size,
            tracks.pixels, tracks.sigma_px, tracks.places, tracks.seen, tracks.anchor, state.rays,
            state.inverse_distances, self._free, priors.gate_sigmas**2, self._normal, self._gradient, self._back,
            self._costs, fill,
        )  # fmt: skip
        cost += (state.log_scale / priors.focal_sigma) ** 2
        if fill:
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
        for k in range(1, self._views):
            first = self._field_size + self._block * (k - 1)
            R[k] = rotation_from_vector(step[first : first + 3]) @ R[k]
            t[k] += step[first + 3 : first + 6]
        if self._field_size:
            for k in range(self._views):
                field[k] += step[self._field_columns(k)]
        local: Floats = self._back[:, :, 0] + self._back[:, :, 4:] @ step
        local = -np.einsum("tpq,tq->tp", self._back[:, :, 1:4], local)
        first_tangent, second_tangent = _tangents(state.rays)
        rays = state.rays + first_tangent * local[:, :1] + second_tangent * local[:, 1:2]
        rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-300)
        inverse = state.inverse_distances
        if not self._is_plane:
            inverse = np.maximum(inverse + np.where(self._free, local[:, 2], 0.0), 0.0)
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
