"""Bundle adjustment for a held camera, with the points eliminated (Schur complement).

It minimizes the error of the graph that :class:`slam_init.bundle.graph.GraphRecipe` makes, in least squares or with a
robust kernel (Cauchy), of poses and points or of the points alone. gtsam takes 3 microseconds an observation for an
iteration, the compiled loops take 0.4. The terms of the poses alone (gauge, baseline range, priors) are those of gtsam.

All lenses share one residual, that of the virtual cameras of the observations. It differs from the residual in raw
pixels by the square of the residual over the focal length: by 0.002 px for 1 px at 500 px.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from quest.descent import descend
from quest.geometry.quaternion import rotation_from_vector
from slam_init.bundle.graph import PoseTerms
from slam_init.bundle.problem import BundleProblem
from slam_init.bundle.reprojection import is_undistorted_first, measured_pixels
from slam_init.bundle.virtual_cameras import needs_virtual_cameras, virtual_cameras
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose

#: Levenberg-Marquardt with the numbers of gtsam: first damping, its largest value, and the absolute decrease of the
#: error below which the iterations end.
_DAMPING, _MOST_DAMPING, _LEAST_DECREASE = 1e-5, 1e5, 1e-5
#: Damping of the covariances: a landmark whose rays are parallel has no information about the poses, and must not stop
#: them.
NONE = 1e-9
#: Tuning constant of the robust kernel with 95 % efficiency on Gaussian residuals (Holland and Welsch 1977).
CAUCHY = 2.3849
#: Steps of points whose poses are held. The fifth moves a typical point by a hundred-thousandth of its distance, and
#: one in twenty by more than 2 in ten thousand (300 simulated points in views with .5 px of noise and 10 % outliers,
#: from distances off by 5 %).
_POINT_STEPS = 5
#: Damping of these steps: points without parallax stay where they are. The rays of a point in the median depth show a
#: million and more about the directions across them.
_POINT_DAMPING = 1.0
#: An error from here on is that of a landmark behind a camera.
_WRONG = 1e11
#: Rotations (K, 3, 3) and translations (K, 3) of world_from_cam, and points (L, 3).
BundleState: TypeAlias = tuple[Floats, Floats, Floats]


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


def fit_points(problem: BundleProblem, noise_px: float) -> BundleProblem:
    """Fit each point robustly to its rays, for the poses of a problem whose median depth is about 1.

    For held poses the points are independent of each other, so that this takes milliseconds.

    * Returns: With other points. A point that a step would move behind a camera stays where it is.
    """
    from slam_init.bundle.kernel import eliminate_points, errors_of_points

    observed, (R, t, points) = by_landmark(problem, noise_px)[:3], state_of(problem)
    errors = errors_of_points(R, t, points, *observed, CAUCHY**2)
    for _ in range(_POINT_STEPS):
        _, _, roots, solved, _ = eliminate_points(R, t, points, *observed, _POINT_DAMPING, CAUCHY**2, True)
        tried = np.ascontiguousarray(points - back_substituted(roots, solved.reshape(-1, 3)))
        lower = errors_of_points(R, t, tried, *observed, CAUCHY**2)
        better = lower <= errors
        points, errors = np.where(better[:, None], tried, points), np.where(better, lower, errors)
    return replace(problem, points=points)


def minimize(
    problem: BundleProblem, noise_px: float, *, iterations: int, tolerance: float, robust: bool = False
) -> tuple[BundleProblem, list[float]]:
    """Minimize the error in poses and points.

    * ``robust``: Whether residuals have a robust kernel. No point of the start lies behind a camera that sees it.
    * ``tolerance``: Relative decrease of the error below which the iterations end.
    * Returns ``errors``: Root mean square residual in pixels at the start and after each iteration.
    """
    observed, terms, cauchy2 = by_landmark(problem, noise_px), PoseTerms(problem), CAUCHY**2 if robust else np.inf

    def step(at: BundleState, damping: float) -> tuple[BundleState, float]:
        equations = equations_of(observed, terms, at, damping, cauchy2)
        try:
            poses = np.asarray(np.linalg.solve(equations.information, -equations.gradient), np.float64)
        except np.linalg.LinAlgError:
            return at, np.inf
        if not np.isfinite(poses).all():
            return at, np.inf
        moved = _moved(at, equations, poses, equations.solved)
        return moved, _error(observed, terms, moved, cauchy2)

    start = state_of(problem)
    with single_threaded():
        state, errors = descend(
            start, _error(observed, terms, start, cauchy2), step, steps=iterations, damping=_DAMPING,
            most_damping=_MOST_DAMPING, tolerance=tolerance, least_decrease=_LEAST_DECREASE,
        )  # fmt: skip
    if not errors[-1] < _WRONG:
        raise RuntimeError("bundle adjustment diverged: a landmark is behind a camera, or the error is not finite")
    return _at_state(problem, state), [noise_px * math.sqrt(2 * error / len(problem.views)) for error in errors]


def by_landmark(problem: BundleProblem, noise_px: float) -> Observed:
    """The observations of a problem in the order of their landmarks, without those that have no ray."""
    known = np.isfinite(problem.virtual[:, 2, 0])
    order = np.flatnonzero(known)[np.argsort(problem.landmarks[known], kind="stable")]
    lenses = problem.virtual[order]
    lenses[:, :2] /= noise_px
    counts = np.bincount(problem.landmarks[order], minlength=len(problem.points))
    starts = np.concatenate([[0], np.cumsum(counts)])
    return Observed(starts, np.ascontiguousarray(problem.views[order]), lenses, order)


def state_of(problem: BundleProblem) -> BundleState:
    """The arrays of a problem."""
    poses = problem.world_from_cam
    R, t = np.array([pose.R for pose in poses]), np.array([pose.t for pose in poses])
    return R, t, np.ascontiguousarray(problem.points)


def _error(observed: Observed, terms: PoseTerms, at: BundleState, cauchy2: float) -> float:
    """Half of the sum of squares, as gtsam's graph has it."""
    from slam_init.bundle.kernel import errors_of_points

    return 0.5 * float(errors_of_points(*at, *observed[:3], cauchy2).sum()) + terms.error(*at[:2])


def equations_of(
    observed: Observed, terms: PoseTerms, at: BundleState, damping: float = NONE, cauchy2: float = np.inf
) -> Equations:
    """The equations of a Gauss-Newton step in the poses, points eliminated."""
    from slam_init.bundle.kernel import eliminate_points

    blocks, gradient, roots, solved, coupling = eliminate_points(*at, *observed[:3], damping, cauchy2, False)
    information, of_terms = terms.equations(*at[:2])
    information -= coupling.T @ coupling
    information[np.diag_indices(len(gradient))] += damping
    for k in range(len(blocks)):
        own = slice(6 * k, 6 * k + 6)
        information[own, own] += blocks[k]
    return Equations(information, gradient + of_terms - coupling.T @ solved, roots, solved, coupling)


def _moved(at: BundleState, equations: Equations, step: Floats, of_points: Floats) -> BundleState:
    """Poses and points after a step (6 K,) of the poses; ``of_points`` (3 L,) is what else the points follow."""
    R, t, points = at
    turns, shifts = np.split(step.reshape(-1, 6), 2, axis=1)
    follow = back_substituted(equations.roots, (of_points + equations.coupling @ step).reshape(-1, 3))
    moved_t = t + np.einsum("kij,kj->ki", R, shifts)
    return np.asarray(R @ rotation_from_vector(turns)), moved_t, np.ascontiguousarray(points - follow)


def stepped(problem: BundleProblem, equations: Equations, step: Floats, of_points: Floats) -> BundleProblem:
    """A problem after a step of its poses.

    Shapes: ``step`` (6 K,), ``of_points`` (3 L,).

    * ``of_points``: What else the points follow, over their roots.
    """
    return _at_state(problem, _moved(state_of(problem), equations, step, of_points))


def _at_state(problem: BundleProblem, state: BundleState) -> BundleProblem:
    R, t, points = state
    poses = tuple(Pose(one, centre) for one, centre in zip(R, t, strict=True))
    return replace(problem, world_from_cam=poses, points=points)


def forward_substituted(roots: Floats, z: Floats) -> Floats:
    """``C^-1 z`` of all points.

    Shapes: ``roots`` (L, 6), ``z`` (L, 3, ...), returns (L, 3, ...).
    """
    c00, c11, c22, c10, c20, c21 = roots.T.reshape(6, -1, *(1,) * (z.ndim - 2))
    x0 = z[:, 0] / c00
    x1 = (z[:, 1] - c10 * x0) / c11
    return np.stack([x0, x1, (z[:, 2] - c20 * x0 - c21 * x1) / c22], axis=1)


def back_substituted(roots: Floats, z: Floats) -> Floats:
    """``C^-T z`` of all points.

    Shapes: ``roots`` (L, 6), ``z`` (L, 3, ...), returns (L, 3, ...).
    """
    c00, c11, c22, c10, c20, c21 = roots.T.reshape(6, -1, *(1,) * (z.ndim - 2))
    x2 = z[:, 2] / c22
    x1 = (z[:, 1] - c21 * x2) / c11
    x0 = (z[:, 0] - c10 * x1 - c20 * x2) / c00
    return np.stack([x0, x1, x2], axis=1)
