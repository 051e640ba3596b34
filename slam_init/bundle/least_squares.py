"""Bundle adjustment in least squares for a held camera, with the points eliminated (Schur complement).

It minimizes the error of the graph that :func:`slam_init.bundle.graph.build_graph` makes. gtsam takes 3 microseconds an
observation for an iteration, and cannot be divided; the compiled loops take 0.4, and pause between the stages of an
iteration. The terms of the poses alone (gauge, baseline range, priors) are those of gtsam.

All lenses share one residual, that of the virtual cameras of the observations. It differs from the residual in raw
pixels by the square of the residual over the focal length: by 0.002 px for 1 px at 500 px.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.graph import PoseTerms
from slam_init.bundle.problem import BundleProblem
from slam_init.bundle.reprojection import is_undistorted_first, measured_pixels
from slam_init.bundle.virtual_cameras import needs_virtual_cameras, virtual_cameras
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose
from slam_init.work import Prices, spend

#: Levenberg-Marquardt with the numbers of gtsam: first damping, its factor after a step, its largest value, and the
#: absolute decrease of the error below which the iterations end.
_DAMPING, _FACTOR, _MOST_DAMPING, _LEAST_DECREASE = 1e-5, 10.0, 1e5, 1e-5
#: Damping of the covariances: a landmark whose rays are parallel tells nothing about the poses, and must not stop them.
_NONE = 1e-9
#: An error from here on is that of a landmark behind a camera.
_WRONG = 1e11
#: Virtual cameras are made for so many observations at once, about 2 ms.
_AT_ONCE = 2000


class _Observations(NamedTuple):
    """The observations in the order of their landmarks: starts (L + 1,), views (M,) and lenses (M, 3, 3)."""

    starts: Ints
    views: Ints
    lenses: Floats


class _Equations(NamedTuple):
    """The equations of the poses without the points, (6 K, 6 K) and (6 K,), and what the points need to follow."""

    information: Floats
    gradient: Floats
    roots: Floats
    solved: Floats
    coupling: Floats


def with_lenses(camera: Camera, problem: BundleProblem) -> BundleProblem:
    """Make the virtual cameras of the observations of a problem."""
    lenses, pixels = np.empty((len(problem.pixels), 3, 3)), problem.pixels
    if is_undistorted_first(camera) and not needs_virtual_cameras(camera):
        # The factors of such a lens measure the pixels of a camera without distortion.
        pixels = measured_pixels(camera, pixels)
        camera = replace(camera, model="pinhole", distortion=())
    for first in range(0, len(lenses), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        spend(Prices.LENS * len(lenses[part]))
        virtual = virtual_cameras(camera, pixels[part])
        right, down, rays = np.moveaxis(virtual.cam_from_virtual, 2, 0)
        fx, skew, fy = virtual.calibrations.T[..., None]
        lenses[part] = np.stack([fx * right + skew * down, fy * down, rays], axis=1)
        lenses[part][~virtual.known] = np.nan
    return replace(problem, lenses=lenses)


def minimize(
    problem: BundleProblem, noise_px: float, *, iterations: int, tolerance: float
) -> tuple[BundleProblem, list[float]]:
    """Minimize the error in poses and points.

    * ``tolerance``: Relative decrease of the error below which the iterations end.
    * Returns ``errors``: Root mean square residual in pixels at the start and after each iteration.
    """
    with single_threaded():
        return _minimized(problem, noise_px, iterations, tolerance)


def _minimized(
    problem: BundleProblem, noise_px: float, iterations: int, tolerance: float
) -> tuple[BundleProblem, list[float]]:
    observed, terms = _by_landmark(problem, noise_px), PoseTerms(problem)
    R, t = _arrays(problem.world_from_cam)
    points = np.ascontiguousarray(problem.points)
    error, damping = _error(observed, terms, R, t, points), _DAMPING
    errors = [_rms_px(error, noise_px, problem)]
    for _ in range(iterations):
        moved, lower = None, np.inf
        while damping <= _MOST_DAMPING:
            moved = _moved(_equations(observed, terms, R, t, points, damping), R, t, points)
            lower = np.inf if moved is None else _error(observed, terms, *moved)
            # At the optimum a step changes the error by rounding only. It need not be tried again.
            if lower - error <= tolerance * error:
                break
            damping *= _FACTOR
        if moved is None or not lower <= error:
            break
        gain, error, damping = error - lower, lower, damping / _FACTOR
        R, t, points = moved
        errors.append(_rms_px(error, noise_px, problem))
        if gain <= max(tolerance * (error + gain), _LEAST_DECREASE):
            break
    if not error < _WRONG:
        raise RuntimeError("bundle adjustment diverged: a landmark is behind a camera, or the error is not finite")
    poses = tuple(Pose(one, centre) for one, centre in zip(R, t, strict=True))
    return replace(problem, world_from_cam=poses, points=points), errors


class MapCovariances(NamedTuple):
    """Marginal covariances of a map: poses (K, 6, 6), points (L, 3, 3), and of the points in the newest view (L, 3, 3).

    Those of the poses are in gtsam's tangent order (rotation, translation), in the camera frame. Those of the points
    are in the world, and in the frame of the newest camera, whose own error is in them.
    """

    poses: Floats
    points: Floats
    in_newest: Floats


def covariances(problem: BundleProblem, noise_px: float) -> MapCovariances:
    """Marginal covariances at the optimum, in the gauge of the graph, for a held camera.

    A point has what its rays leave open for known poses, and what the errors of the poses add. With the names of
    :func:`slam_init.bundle.kernel.eliminate_points` and the covariance S of the poses it is
    ``C^-T (I + Y S Y^T) C^-1``.
    """
    observed, terms = _by_landmark(problem, noise_px), PoseTerms(problem)
    R, t = _arrays(problem.world_from_cam)
    with single_threaded():
        equations = _equations(observed, terms, R, t, np.ascontiguousarray(problem.points), _NONE)
        information = equations.information
        # The gauge is stiffer than the landmarks by many orders: in units of its diagonal the matrix is well
        # conditioned.
        units = np.sqrt(np.diag(information))
        try:
            covariance = np.linalg.inv(information / np.outer(units, units)) / np.outer(units, units)
        except np.linalg.LinAlgError as error:
            raise RuntimeError(f"the poses are not determined: {error}") from None
    if not np.isfinite(covariance).all():
        raise RuntimeError("the poses are not determined")
    count = len(problem.frames)
    blocks = covariance.reshape(count, 6, count, 6)[np.arange(count), :, np.arange(count)]
    spend(Prices.MAP_COVARIANCES * len(problem.points) * count**2)
    C = np.zeros((len(problem.points), 3, 3))
    C[:, (0, 1, 2, 1, 2, 2), (0, 1, 2, 0, 0, 1)] = equations.roots
    followed = np.swapaxes(np.linalg.inv(C), 1, 2)
    by_poses = -followed @ equations.coupling.reshape(-1, 3, 6 * count)
    of_rays = followed @ np.swapaxes(followed, 1, 2)
    # A point X is y = R^T (X - t) in a camera: with the tangent (w, v) of its pose, dy = R^T dX - v + y x w.
    to_camera, y = R[-1].T, (problem.points - t[-1]) @ R[-1]
    in_newest = to_camera @ by_poses
    in_newest[:, :, -6:-3] += np.cross(np.eye(3), y[:, None])  # rows of the matrix of y x
    in_newest[:, :, -3:] -= np.eye(3)
    return MapCovariances(
        np.asarray(0.5 * (blocks + np.swapaxes(blocks, 1, 2))),
        of_rays + _spread(by_poses, covariance),
        to_camera @ of_rays @ to_camera.T + _spread(in_newest, covariance),
    )


def _spread(J: Floats, covariance: Floats) -> Floats:
    """Covariances (L, 3, 3) of linear functions (L, 3, X) of unknowns with a covariance (X, X)."""
    with single_threaded():
        followed = (J.reshape(-1, J.shape[2]) @ covariance).reshape(J.shape)
    return np.asarray(np.einsum("lix,ljx->lij", followed, J))


def _by_landmark(problem: BundleProblem, noise_px: float) -> _Observations:
    if problem.lenses is None:
        raise ValueError("a problem without lenses: make them by with_lenses")
    known = np.isfinite(problem.lenses[:, 2, 0])
    order = np.flatnonzero(known)[np.argsort(problem.landmarks[known], kind="stable")]
    lenses = problem.lenses[order]
    lenses[:, :2] /= noise_px
    counts = np.bincount(problem.landmarks[order], minlength=len(problem.points))
    starts = np.concatenate([[0], np.cumsum(counts)])
    return _Observations(starts, np.ascontiguousarray(problem.views[order]), lenses)


def _arrays(poses: tuple[Pose, ...]) -> tuple[Floats, Floats]:
    return np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses])


def _error(observed: _Observations, terms: PoseTerms, R: Floats, t: Floats, points: Floats) -> float:
    """Half of the sum of squares, as gtsam's graph has it."""
    from slam_init.bundle.kernel import squared_error

    spend(Prices.MAP_ERROR + Prices.MAP_ERROR_OBSERVATION * len(observed.views))
    return 0.5 * squared_error(R, t, points, *observed) + terms.error(R, t)


def _equations(
    observed: _Observations, terms: PoseTerms, R: Floats, t: Floats, points: Floats, damping: float
) -> _Equations:
    from slam_init.bundle.kernel import eliminate_points

    views, count = len(R), len(points)
    spend(Prices.MAP_EQUATIONS * len(observed.views))
    blocks, gradient = np.empty((views, 6, 6)), np.empty(6 * views)
    roots, solved, coupling = np.empty((count, 6)), np.empty(3 * count), np.empty((3 * count, 6 * views))
    eliminate_points(R, t, points, *observed, damping, blocks, gradient, roots, solved, coupling)
    spend(Prices.MAP_STEP + Prices.MAP_ELIMINATION * count * views**2)
    information, of_terms = terms.equations(R, t)
    information -= coupling.T @ coupling
    information[np.diag_indices(6 * views)] += damping
    for k in range(views):
        own = slice(6 * k, 6 * k + 6)
        information[own, own] += blocks[k]
    return _Equations(information, gradient + of_terms - coupling.T @ solved, roots, solved, coupling)


def _moved(equations: _Equations, R: Floats, t: Floats, points: Floats) -> tuple[Floats, Floats, Floats] | None:
    """Poses and points after a step; None where the equations have no solution."""
    try:
        step = np.asarray(np.linalg.solve(equations.information, -equations.gradient), np.float64)
    except np.linalg.LinAlgError:
        return None
    if not np.isfinite(step).all():
        return None
    turns, shifts = np.split(step.reshape(-1, 6), 2, axis=1)
    z = (equations.solved + equations.coupling @ step).reshape(-1, 3)
    c00, c11, c22, c10, c20, c21 = equations.roots.T
    x2 = z[:, 2] / c22
    x1 = (z[:, 1] - c21 * x2) / c11
    x0 = (z[:, 0] - c10 * x1 - c20 * x2) / c00
    moved = np.ascontiguousarray(points - np.column_stack([x0, x1, x2]))
    return np.asarray(R @ rotation_from_vector(turns)), t + np.einsum("kij,kj->ki", R, shifts), moved


def _rms_px(error: float, noise_px: float, problem: BundleProblem) -> float:
    """Root mean square of the 2-D residuals from half of the sum of squares."""
    return float(noise_px * np.sqrt(2 * error / len(problem.views)))
