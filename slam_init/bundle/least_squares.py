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

#: Levenberg-Marquardt with the numbers of gtsam: first damping, its factor after a step, its largest value, and the
#: absolute decrease of the error below which the iterations end.
_DAMPING, _FACTOR, _MOST_DAMPING, _LEAST_DECREASE = 1e-5, 10.0, 1e5, 1e-5
#: Damping of the covariances: a landmark whose rays are parallel tells nothing about the poses, and must not stop them.
NONE = 1e-9
#: An error from here on is that of a landmark behind a camera.
_WRONG = 1e11


class Observed(NamedTuple):
    """The observations in the order of their landmarks."""

    #: (L + 1,) The observations of landmark l are those from ``starts[l]`` up to ``starts[l + 1]``.
    starts: Ints
    #: (M,)
    views: Ints
    #: (M, 3, 3) Virtual cameras, over the noise.
    lenses: Floats
    #: (M,) Positions in the problem.
    order: Ints


class Equations(NamedTuple):
    """The equations of the poses without the points, (6 K, 6 K) and (6 K,), and what the points need to follow."""

    information: Floats
    gradient: Floats
    roots: Floats
    solved: Floats
    coupling: Floats


def with_lenses(camera: Camera, problem: BundleProblem) -> BundleProblem:
    """Make the virtual cameras of the observations of a problem."""
    pixels = problem.pixels
    if is_undistorted_first(camera) and not needs_virtual_cameras(camera):
        # The factors of such a lens measure the pixels of a camera without distortion.
        pixels = measured_pixels(camera, pixels)
        camera = replace(camera, model="pinhole", distortion=())
    virtual = virtual_cameras(camera, pixels)
    right, down, rays = np.moveaxis(virtual.cam_from_virtual, 2, 0)
    fx, skew, fy = virtual.calibrations.T[..., None]
    lenses = np.stack([fx * right + skew * down, fy * down, rays], axis=1)
    lenses[~virtual.known] = np.nan
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
    observed, terms = by_landmark(problem, noise_px), PoseTerms(problem)
    R, t = arrays_of(problem.world_from_cam)
    points = np.ascontiguousarray(problem.points)
    error, damping = _error(observed, terms, R, t, points), _DAMPING
    errors = [_rms_px(error, noise_px, problem)]
    for _ in range(iterations):
        moved, lower = None, np.inf
        while damping <= _MOST_DAMPING:
            moved = _moved(equations_of(observed, terms, R, t, points, damping), R, t, points)
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


def by_landmark(problem: BundleProblem, noise_px: float) -> Observed:
    """The observations of a problem in the order of their landmarks, without those that have no ray."""
    if problem.lenses is None:
        raise ValueError("a problem without lenses: make them by with_lenses")
    known = np.isfinite(problem.lenses[:, 2, 0])
    order = np.flatnonzero(known)[np.argsort(problem.landmarks[known], kind="stable")]
    lenses = problem.lenses[order]
    lenses[:, :2] /= noise_px
    counts = np.bincount(problem.landmarks[order], minlength=len(problem.points))
    starts = np.concatenate([[0], np.cumsum(counts)])
    return Observed(starts, np.ascontiguousarray(problem.views[order]), lenses, order)


def arrays_of(poses: tuple[Pose, ...]) -> tuple[Floats, Floats]:
    """Rotations (K, 3, 3) and translations (K, 3) of poses."""
    return np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses])


def _error(observed: Observed, terms: PoseTerms, R: Floats, t: Floats, points: Floats) -> float:
    """Half of the sum of squares, as gtsam's graph has it."""
    from slam_init.bundle.kernel import squared_error

    return 0.5 * squared_error(R, t, points, *observed[:3]) + terms.error(R, t)


def equations_of(
    observed: Observed, terms: PoseTerms, R: Floats, t: Floats, points: Floats, damping: float
) -> Equations:
    """The equations of a Gauss-Newton step in the poses, points eliminated."""
    from slam_init.bundle.kernel import eliminate_points

    views, count = len(R), len(points)
    blocks, gradient = np.empty((views, 6, 6)), np.empty(6 * views)
    roots, solved, coupling = np.empty((count, 6)), np.empty(3 * count), np.empty((3 * count, 6 * views))
    eliminate_points(R, t, points, *observed[:3], damping, blocks, gradient, roots, solved, coupling)
    information, of_terms = terms.equations(R, t)
    information -= coupling.T @ coupling
    information[np.diag_indices(6 * views)] += damping
    for k in range(views):
        own = slice(6 * k, 6 * k + 6)
        information[own, own] += blocks[k]
    return Equations(information, gradient + of_terms - coupling.T @ solved, roots, solved, coupling)


def _moved(equations: Equations, R: Floats, t: Floats, points: Floats) -> tuple[Floats, Floats, Floats] | None:
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
