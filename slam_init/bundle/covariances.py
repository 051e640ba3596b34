"""The covariances of a map: what the noise of the tracks leaves open, and what the errors add that tracks share.

The map holds the lens as it is stated. What the calibration leaves open moves all views and points together, so it does
not average out over tracks: it has a variable of its own in the graph, and its part in the covariances.

A covariance is written as its causes: independent errors of unit variance, and how far poses and points follow each of
them. The causes are the noise of the poses, the coefficients of the fields of correlated errors of the views, the lens,
and for each point its rays. With the names of :func:`slam_init.bundle.kernel.eliminate_points`, the poses x and the
shared errors s have the equations ``P x + B s``, so that the poses follow by ``-P^-1 B``, and a point follows by
``-C^-T (Y x + C^-1 V s)``.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slam_init.bundle.graph import PoseTerms
from slam_init.bundle.least_squares import (
    Equations,
    Observed,
    back_substituted,
    by_landmark,
    equations_of,
    forward_substituted,
    state_of,
    with_lenses,
)
from slam_init.bundle.problem import BundleProblem
from slam_init.bundle.reprojection import is_undistorted_first
from slam_init.bundle.virtual_cameras import needs_virtual_cameras
from slam_init.config import MapConfig
from slam_init.system.linear_algebra import single_threaded
from slam_init.types.arrays import Bools, Floats, Ints
from slam_init.types.camera import Camera
from slam_init.types.correlated_errors import orthonormal_polynomials
from slam_init.types.lens import CALIBRATED_SIGMA, MAX_FOCAL_SIGMA, UNKNOWN_PRINCIPAL_SIGMA, LensPrior, k1_sigma

#: Parameters of the lens, and of the field of a view, among the shared errors. A fit of the lens has a k2 besides.
LENS, FIELD = 4, 12


class ErrorModel(NamedTuple):
    """The errors of the observations of a map (:mod:`slam_init.bundle.shared_errors`).

    The map holds the lens as it is stated, and has no fields: their errors are those of the prior then. A fit of them
    would follow errors of all kinds; it made directions worse by a half in simulated worlds with an exact lens.
    """

    #: Standard deviation of the residuals.
    noise_px: float
    #: That of the errors of single tracks, over the noise.
    by_tracks: float
    lens: LensPrior
    #: Standard deviation of the twelve coefficients of the field of a view, six for each coordinate.
    correlated_px: float
    #: Variance of the noise of the graph over that of the covariances. The tracks have so much less information about
    #: the lens.
    excess: float = 1.0

    @property
    def overdispersion(self) -> float:
        """Standard deviation of independent noise that covers all errors but the lens, over the noise."""
        return self.by_tracks * math.sqrt(self.excess)

    @property
    def noise_of_graph_px(self) -> float:
        """The noise that the graph states, which covers errors that are not independent."""
        return self.overdispersion * self.noise_px


class MapCovariances(NamedTuple):
    """Marginal covariances of a map."""

    #: (K, 6, 6) In gtsam's tangent order (rotation, translation), in the camera frame.
    poses: Floats
    #: (L, 3, 3) In the world.
    points: Floats
    #: in_newest, by_noise: (L, 3, 3) In the frame of the newest camera, whose own error is in them; and the same by the
    #: noise of single tracks alone.
    in_newest: Floats
    by_noise: Floats
    #: (L, C) How far each cause that the landmarks share moves the logarithm of a distance from the newest camera.
    stretched: Floats
    #: (4, 4) Of the lens, in the order of :func:`lens_derivatives`.
    lens: Floats
    #: (L,) Share of a landmark with two views in the only residual that tests it, between 0 and 1; 0 for others.
    leverage: Floats


class SharedEquations(NamedTuple):
    """The equations of poses and shared errors, points eliminated.

    There are S shared errors: log focal length, principal point (2) and k1 of the lens; then the fields of the views,
    12 K coefficients, or without fields the k2 of a pinhole or radial-tangential lens.
    """

    observed: Observed
    #: by_pose, by_point: (M, 2, 6) and (M, 2, 3) Derivatives of the residuals.
    by_pose: Floats
    by_point: Floats
    equations: Equations
    #: (L, 3, S) ``C^-1 V``.
    of_points: Floats
    #: (6 K, S) Of poses and shared errors.
    coupling: Floats
    #: (K, 16, 16) Products of lens and field of a view, before the elimination; (K, 5, 5) without fields.
    own: Floats
    #: (S,) and (L, 6 K): the gradient by the shared errors, and the scores of the landmarks: their parts in that by the
    #: poses, whose other part is the gradient of ``equations``: that of the terms of the poses alone.
    gradient: Floats
    scores: Floats


class PoseCauses(NamedTuple):
    """How far the poses of a map follow each cause of their errors."""

    #: (6 K, 6 K) Noise of the poses, (6 K, 12 K) coefficients of the fields, and (6 K, 4) lens.
    noise: Floats
    fields: Floats
    lens: Floats
    #: (4, 4) Of the lens itself.
    of_lens: Floats


def lens_prior(stated: Camera, config: MapConfig) -> LensPrior:
    """What is known of the lens besides the tracks.

    * ``stated``: The camera before the adjustment of its focal length.
    """
    share = config.lens_uncertainty
    focal = share * min(stated.focal_sigma or CALIBRATED_SIGMA, MAX_FOCAL_SIGMA)
    estimated = (stated.focal_sigma or 0.0) > CALIBRATED_SIGMA
    return LensPrior(
        focal_sigma=config.focal_sigma if config.refine_focal else focal,
        k1_sigma=share * k1_sigma(stated),
        principal_sigma_px=share * UNKNOWN_PRINCIPAL_SIGMA * stated.width,
        fitted=(config.refine_focal or estimated, False, False, estimated),
    )


def at_projections(camera: Camera, problem: BundleProblem) -> BundleProblem:
    """The same problem without residuals: each landmark is observed where it projects to.

    The equations of a problem with residuals count products of residuals as information about the lens.
    """
    return with_lenses(camera, replace(problem, pixels=problem.pixels + problem.residuals(camera)))


def covariances(camera: Camera, problem: BundleProblem, errors: ErrorModel) -> MapCovariances:
    """Marginal covariances at the optimum, in the gauge of the graph.

    * ``problem``: Of :func:`at_projections`.
    """
    found = shared_equations(camera, problem, errors.by_tracks * errors.noise_px)
    covariance = inverse_of_poses(found.equations.information)
    with single_threaded():
        poses = causes_of_poses(found, errors, covariance)
        by_causes = np.concatenate([poses.noise, poses.fields, poses.lens], axis=1)
        followed = (found.equations.coupling @ by_causes).reshape(len(problem.points), 3, -1)
    direct = errors.correlated_px * found.of_points[:, :, LENS:], found.of_points[:, :, :LENS] @ poses.of_lens
    followed[:, :, poses.noise.shape[1] :] += np.concatenate(direct, axis=2)
    by_view = by_causes.reshape(len(problem.frames), 6, -1)
    return MapCovariances(
        np.asarray(by_view @ np.swapaxes(by_view, 1, 2)),
        *_of_points(problem, found.equations.roots, followed, by_causes[-6:]),
        poses.of_lens @ poses.of_lens.T,
        _leverage(found, covariance),
    )


def _of_points(
    problem: BundleProblem, roots: Floats, followed: Floats, newest: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """The covariances of the points, and how far they are stretched; see :class:`MapCovariances`.

    Shapes: ``roots`` (L, 6), ``followed`` (L, 3, C), ``newest`` (6, C).

    * ``followed``: A point moves by ``-C^-T`` times a column for its cause, and by one of ``-C^-T`` for its own rays.
    * ``newest``: How far the newest camera follows each cause.
    """
    pose, noise = problem.world_from_cam[-1], slice(6 * len(problem.frames))
    rays = back_substituted(roots, np.broadcast_to(np.eye(3), (len(roots), 3, 3)))
    world, seen = -back_substituted(roots, followed), pose.inverse().apply(problem.points)
    own = rays @ np.swapaxes(rays, 1, 2)
    # The points turn and move against the camera: how far each one moves for a step of the camera.
    against = np.concatenate([np.cross(np.eye(3), seen[:, None]), np.broadcast_to(-np.eye(3), own.shape)], axis=2)

    def in_camera(moves: Floats, camera: Floats) -> Floats:
        """The covariances in the camera of points that move in the world, and of the camera itself."""
        both = np.swapaxes((moves.reshape(-1, moves.shape[2]) @ camera.T).reshape(-1, 3, 6), 1, 2)
        mixed = against @ both @ pose.R
        return np.asarray(
            pose.R.T @ (moves @ np.swapaxes(moves, 1, 2) + own) @ pose.R
            + mixed + np.swapaxes(mixed, 1, 2) + against @ (camera @ camera.T) @ np.swapaxes(against, 1, 2)
        )  # fmt: skip

    along = (seen @ pose.R.T)[:, None] @ world + seen[:, None] @ against @ newest
    stretched = along[:, 0] / np.sum(seen**2, axis=1)[:, None]
    by_world = world @ np.swapaxes(world, 1, 2) + own
    return by_world, in_camera(world, newest), in_camera(world[:, :, noise], newest[:, noise]), stretched


def _leverage(found: SharedEquations, covariance: Floats) -> Floats:
    """Share (L,) of each landmark with two views in its own residual; 0 for others.

    Four coordinates and three unknowns leave one residual, along ``u`` across the derivatives by the point. Its
    derivative by the poses is ``g``, and the errors of the poses move it by ``g^T S g`` in units of the noise.
    """
    observed = found.observed
    pairs = np.flatnonzero(np.diff(observed.starts) == 2)
    rows = observed.starts[pairs][:, None] + np.arange(2)
    u = np.linalg.qr(found.by_point[rows].reshape(-1, 4, 3), mode="complete").Q[..., 3].reshape(-1, 2, 2)
    g = np.einsum("pvj,pvji->pvi", u, found.by_pose[rows]).reshape(-1, 12)
    at = (6 * observed.views[rows][..., None] + np.arange(6)).reshape(-1, 12)
    leverage = np.zeros(len(observed.starts) - 1)
    leverage[pairs] = np.einsum("pi,pij,pj->p", g, covariance[at[:, :, None], at[:, None, :]], g)
    return leverage


def causes_of_poses(found: SharedEquations, errors: ErrorModel, covariance: Floats) -> PoseCauses:
    """How far the poses follow each cause, with the covariance (6 K, 6 K) that the noise alone leaves."""
    follows = -covariance @ found.coupling
    flat = found.of_points[:, :, :LENS].reshape(-1, LENS)
    information = found.own[:, :LENS, :LENS].sum(axis=0) - flat.T @ flat
    information += found.coupling[:, :LENS].T @ follows[:, :LENS]
    information *= np.outer(errors.lens.fitted, errors.lens.fitted) / errors.excess
    of_lens = root_of_lens(information, errors.lens.sigmas)
    return PoseCauses(_root(covariance), errors.correlated_px * follows[:, LENS:], follows[:, :LENS] @ of_lens, of_lens)


def shared_equations(
    camera: Camera,
    problem: BundleProblem,
    noise_px: float,
    measured: BundleProblem | None = None,
    *,
    fields: bool = True,
) -> SharedEquations:
    """The equations of poses and shared errors.

    * ``problem``: Of :func:`at_projections`.
    * ``measured``: The same problem with what was measured; by default there are no residuals.
    * ``fields``: Whether the views have fields. Without them the lens has its k2 besides.
    """
    from slam_init.bundle.kernel import derivatives

    observed, terms = by_landmark(problem, noise_px), PoseTerms(problem)
    state, count, views = state_of(problem), len(problem.points), len(problem.frames)
    by_pose, by_point = derivatives(*state, *observed[:3])
    left = np.zeros((len(problem.pixels), 2)) if measured is None else _residuals(problem, measured)
    by_lens, left = (one[observed.order] / noise_px for one in (lens_derivatives(camera, problem), left))
    if fields:
        places = orthonormal_polynomials(camera, problem.pixels)[observed.order]
        # A field moves a pixel along both coordinates, as the principal point does, by the sum of six polynomials each.
        by_field = by_lens[:, :, 1:3, None] * places[:, None, None]
        errors = np.concatenate([by_lens, by_field.reshape(len(left), 2, FIELD)], axis=2)
        lens, field = LENS, FIELD
    else:
        x = problem.virtual[observed.order, 2, :2] / problem.virtual[observed.order, 2, 2:]
        by_k2 = np.sum(x * x, axis=1)[:, None, None] * by_lens[:, :, LENS - 1 :]
        errors, lens, field = np.concatenate([by_lens, by_k2], axis=2), LENS + 1, 0
    size, landmarks = lens + field * views, np.repeat(np.arange(count), np.diff(observed.starts))
    columns = np.broadcast_to(np.arange(lens + field), (len(left), lens + field)).copy()
    columns[:, lens:] += field * observed.views[:, None]
    rows = 3 * landmarks[:, None] + np.arange(3)
    of_points = _summed(
        size * rows[:, :, None] + columns[:, None], np.swapaxes(by_point, 1, 2) @ errors, 3 * count * size
    )
    solved = _summed(rows, np.einsum("mji,mj->mi", by_point, left), 3 * count).reshape(-1, 3)
    gradient = _summed(columns, np.einsum("mji,mj->mi", errors, left), size)
    poses = 6 * (views * landmarks + observed.views)[:, None] + np.arange(6)
    scores = _summed(poses, np.einsum("mji,mj->mi", by_pose, left), 6 * views * count).reshape(count, -1)
    coupling, own = np.zeros((views, 6, size)), np.zeros((views, lens + field, lens + field))
    with single_threaded():
        equations = equations_of(observed, terms, state)
        for view in range(views):
            of_view = np.flatnonzero(observed.views == view)
            flat = errors[of_view].reshape(-1, lens + field)
            own[view] = flat.T @ flat
            at = np.r_[:lens, lens + field * view : lens + field * (view + 1)]
            coupling[view][:, at] = by_pose[of_view].reshape(-1, 6).T @ flat
        of_points = forward_substituted(equations.roots, of_points.reshape(count, 3, size))
        solved = forward_substituted(equations.roots, solved)
        flat, of_poses = of_points.reshape(-1, size), equations.coupling
        reduced = coupling.reshape(-1, size) - of_poses.T @ flat
        gradient -= flat.T @ solved.ravel()
        scores -= np.einsum("li,lij->lj", solved, of_poses.reshape(count, 3, -1))
    return SharedEquations(observed, by_pose, by_point, equations, of_points, reduced, own, gradient, scores)


def _residuals(projected: BundleProblem, measured: BundleProblem) -> Floats:
    """The residuals (M, 2) of a problem in the virtual cameras of its projections."""
    across, rays = np.split(projected.virtual, [2], axis=1)
    return np.asarray(np.einsum("mij,mj->mi", across, rays[:, 0] - measured.virtual[:, 2]))


def lens_derivatives(camera: Camera, projected: BundleProblem) -> Floats:
    """How the residuals in the virtual cameras follow the lens: log focal length, principal point (2), k1.

    Another lens sees the same pixel along another ray. That moves the residual by the move of the ray. An error of a
    measured pixel moves it as an error of the principal point does, with the other sign.

    Shapes: returns (M, 2, 4).

    * Returns: 0 where another lens does not see the pixel.
    """
    across, rays = projected.virtual[:, :2], projected.virtual[:, 2]
    found = camera.differentiated(rays)
    principal = np.broadcast_to(np.eye(2), (len(across), 2, 2))
    by_focal = (found.pixels - (camera.cx, camera.cy))[..., None]
    if is_undistorted_first(camera) and not needs_virtual_cameras(camera):
        # Another focal length leaves the undistorted pixels as they are.
        by_focal = found.by_point[:, :, :2] @ rays[:, :2, None]
    by_lens = np.concatenate([by_focal, principal, found.by_k1[..., None]], axis=2)
    # The shortest move of the ray that takes the pixel back: a ray does not move along itself.
    seen: Bools = np.asarray(np.isfinite(found.pixels[:, 0]))
    J = np.where(seen[:, None, None], found.by_point, np.eye(2, 3))
    back = np.swapaxes(J, 1, 2) @ np.asarray(np.linalg.inv(J @ np.swapaxes(J, 1, 2)), np.float64)
    return np.asarray(np.nan_to_num(across @ back @ by_lens))


def _summed(places: Ints, terms: Floats, size: int) -> Floats:
    """Sums (size,) of terms by their places."""
    return np.asarray(np.bincount(places.ravel(), terms.ravel(), size), np.float64)


def inverse_of_poses(information: Floats) -> Floats:
    """The covariance of the poses.

    The gauge is stiffer than the landmarks by many orders: in units of its diagonal the matrix is well conditioned.
    """
    units = np.sqrt(np.diag(information))
    try:
        covariance = np.linalg.inv(information / np.outer(units, units)) / np.outer(units, units)
    except np.linalg.LinAlgError as error:
        raise RuntimeError(f"the poses are not determined: {error}") from None
    if not np.isfinite(covariance).all():
        raise RuntimeError("the poses are not determined")
    return np.asarray(covariance)


def root_of_lens(information: Floats, sigmas: Floats) -> Floats:
    """A root (4, 4) of the covariance of the lens by its prior and by the tracks.

    It is computed in units of the prior, in which a parameter may be exact.
    """
    scaled = sigmas[:, None] * (0.5 * (information + information.T)) * sigmas
    return np.asarray(sigmas[:, None] * np.linalg.cholesky(np.linalg.inv(np.eye(len(sigmas)) + scaled)))


def _root(covariance: Floats) -> Floats:
    """A root of a covariance of poses, in units of its diagonal."""
    units = np.sqrt(np.diag(covariance))
    scaled = covariance / np.outer(units, units)
    try:
        return np.asarray(units[:, None] * np.linalg.cholesky(0.5 * (scaled + scaled.T)))
    except np.linalg.LinAlgError as error:
        raise RuntimeError(f"the poses are not determined: {error}") from None
