"""The readable halves of compiled functions of quest: noise, planes, covariances, rotations."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from reference_ransac import RelativePoseProblem

from quest.geometry.homography import decompose_homography, fit_homography, homography_residuals
from quest.geometry.quaternion import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from quest.geometry.refine import sampson_jacobian, tangent_basis
from quest.relative_pose import Hypothesis
from quest.robust.plane import PlaneFit
from quest.robust.samples import draw_samples

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

#: As quest has them.
GATE_SIGMAS, LEAST_ON_PLANE, SAMPLES = 3.0, 8, 64


def refine_with_noise(problem: RelativePoseProblem, model: Floats) -> tuple[Floats, float]:
    """Refine a motion by the likelihood of a mixture, see :mod:`quest.robust.kernels.mixture`.

    Shapes: ``model`` (7,), returns ``model`` (7,).

    * Returns ``noise_rad``: Standard deviation of a bearing, from the median absolute residual; at least a thousandth
      of the threshold.
    """
    threshold_rad, m, n = problem.threshold_rad, problem.m, problem.n
    R, t = matrix_from_quaternion(model[:4]), model[4:]
    shares, s = np.tile(PRIOR, (4, 1)), 0.0
    for turn in range(3):
        near, group = _near_and_group(problem, R, t)
        if near.sum() < 6:
            return np.r_[quaternion_from_matrix(R), t], threshold_rad / GATE_SIGMAS
        r = sampson_jacobian(R, t, m[near], n[near])[0]
        if turn == 0:
            s = 1.4826 * float(np.median(np.abs(r[group < 2])))
        for _ in range(60):
            shares, s, weight = _expected(r, group, threshold_rad, shares, s)
            r, J = sampson_jacobian(R, t, m[near], n[near])
            A = (J * weight[:, None]).T @ J
            step = -np.linalg.solve(A + 1e-12 * np.trace(A) * np.eye(5), (J * weight[:, None]).T @ r)
            R, t = rotation_from_vector(step[:3]) @ R, t + tangent_basis(t) @ step[3:]
            t = t / np.linalg.norm(t)
    near, group = _near_and_group(problem, R, t)
    r = sampson_jacobian(R, t, m[near], n[near])[0][group < 2]
    few = 1 + 5 / max(len(r) - 5, 1)  # the motion has adapted to few matches by its five unknowns
    noise_rad = max(1.4826 * few * float(np.median(np.abs(r))), 1e-3 * threshold_rad)
    return np.r_[quaternion_from_matrix(R), t], noise_rad


#: Shares of exact matches, of less exact ones and of outliers in a group without a match.
PRIOR = np.array([0.5, 0.25, 0.25])


def _near_and_group(problem: RelativePoseProblem, R: Floats, t: Floats) -> tuple[Bools, NDArray[np.int64]]:
    """The matches within the threshold (N,), and the groups of these by their distance from the typical depth."""
    r2, behind = problem.residuals(np.r_[quaternion_from_matrix(R), t][None])
    near = (r2[0] < problem.threshold_rad**2) & ~behind[0]
    m, n = problem.m[near], problem.n[near]
    along = t - (n @ t)[:, None] * n
    ratio = np.sum((n - m @ R.T) * along, axis=1) / np.sum(along**2, axis=1)
    distance = np.abs(ratio - np.median(ratio))
    return near, np.searchsorted([3, 6, 12], distance / np.median(distance))


def _expected(
    r: Floats, group: NDArray[np.int64], threshold_rad: float, shares: Floats, s: float
) -> tuple[Floats, float, Floats]:
    """One step of expectation: the shares (4, 3), s and the weights of the matches."""
    scales = np.array([s, 3 * s])
    density = np.sqrt(2 / np.pi) / scales * np.exp(-0.5 * (r[:, None] / scales) ** 2)
    parts = shares[group] * np.column_stack([density, np.full(len(r), 1 / threshold_rad)])
    parts /= parts.sum(axis=1, keepdims=True)
    weight = parts[:, 0] + parts[:, 1] / 9
    squares = np.sum(weight * r**2) + threshold_rad**2 / 9
    s_new = np.sqrt(squares / max(parts[:, :2].sum() - 5 + 1, 1))
    sums = np.array([PRIOR + parts[group == k].sum(axis=0) for k in range(4)])
    return sums / sums.sum(axis=1, keepdims=True), min(max(s_new, 1e-3 * threshold_rad), threshold_rad / 2), weight


def fit_plane(model: Floats, m: Floats, n: Floats, noise_rad: float) -> PlaneFit:
    """Fit the plane that explains most of the matches of a motion.

    Shapes: ``model`` (7,), ``m, n`` (N, 3).

    * Returns: Without poses where less than half of the matches lie on a plane, or fewer than eight.
    """
    R, t = matrix_from_quaternion(model[:4]), model[4:]
    # The inverse depth of a point on a plane is k . m: project n x (R m + t (k . m)) = 0 on the epipolar line.
    a = m @ R.T
    n_cross_t = np.cross(n, t)
    lhs = -np.einsum("ij,ij->i", n_cross_t, np.cross(n, a))
    gain = np.einsum("ij,ij->i", n_cross_t, n_cross_t)
    k = _robust_plane(m, lhs, gain, noise_rad, np.random.default_rng(0))
    if k is None:
        return PlaneFit(0, len(m), np.inf, np.inf, [])
    gate2 = 2 * (GATE_SIGMAS * noise_rad) ** 2
    H = R + np.outer(t, k)
    on_plane = np.sum(homography_residuals(H, m, n) ** 2, axis=1) < 2 * gate2
    for _ in range(3):
        # Where most points lie off the plane, they refute its other motion.
        if on_plane.sum() < max(LEAST_ON_PLANE, 0.5 * len(m)):
            return PlaneFit(int(on_plane.sum()), int((~on_plane).sum()), np.inf, np.inf, [])
        H = fit_homography(m[on_plane], n[on_plane])
        on_plane = np.sum(homography_residuals(H, m, n) ** 2, axis=1) < gate2
    poses = _poses_of_plane(H, m[on_plane], model)
    on = int(on_plane.sum())
    # A residual across the epipolar line measures the motion, a residual along it measures the plane.
    lines = np.cross(n_cross_t, n)
    lines /= np.maximum(np.linalg.norm(lines, axis=1, keepdims=True), 1e-300)
    along = np.einsum("ij,ij->i", homography_residuals(H, m, n), lines)
    relief = float(np.minimum((along / noise_rad) ** 2, GATE_SIGMAS**2).sum())
    deviation = 1.4826 * float(np.median(np.abs(along[on_plane]))) if on else np.inf
    return PlaneFit(on, len(m) - on, deviation, relief, poses)


def off_line_rad(rays: Floats) -> float:
    """Distance of rays from their best great circle, as a standard deviation by the median.

    Shapes: ``rays`` (N, 3).
    """
    weight = np.ones(len(rays))
    distance = np.zeros(len(rays))
    # A few rays off the line, outliers among them, must not tilt it: their weight falls with each step.
    for _ in range(4):
        normal = np.linalg.eigh((rays * weight[:, None]).T @ rays)[1][:, 0]
        distance = np.abs(rays @ normal)
        scale = max(1.4826 * float(np.median(distance)), 1e-12)
        weight = 1 / (1 + (distance / (GATE_SIGMAS * scale)) ** 2) ** 2
    return 1.4826 * float(np.median(distance))


def _robust_plane(m: Floats, lhs: Floats, gain: Floats, noise_rad: float, rng: np.random.Generator) -> Floats | None:
    """The plane k (3,) with ``gain (k . m) = lhs`` for most points: the best of samples of three."""
    if len(m) < LEAST_ON_PLANE:
        return None
    samples = draw_samples(rng, len(m), 3, SAMPLES)
    A = m[samples] * gain[samples][..., None]
    keep = np.abs(np.linalg.det(A)) > 1e-30
    if not keep.any():
        return None
    planes = np.linalg.solve(A[keep], lhs[samples][keep][..., None])[..., 0]
    # Displacement along the epipolar line, in units of the noise of one bearing.
    root = np.sqrt(np.maximum(gain, 1e-300))
    residual = np.abs((planes @ m.T) * root - lhs / root) / np.sqrt(2.0)
    limit = GATE_SIGMAS * noise_rad
    return np.asarray(planes[int(np.argmin(np.minimum(residual, limit).sum(axis=1)))])


def pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """Covariance of an M-estimate with the kernel of Geman and McClure.

    It is ``mean(psi^2) / mean(psi')^2`` times the inverse of ``J^T J``, psi the derivative of the kernel.

    Shapes: ``m, n`` (N, 3), returns (5, 5).

    * Returns: In rad^2, in the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    inliers = hypothesis.inliers
    r, J = sampson_jacobian(hypothesis.R, hypothesis.t, m[inliers], n[inliers])
    return np.asarray(_spread(r, noise_rad, J.shape[1]) * np.linalg.pinv(J.T @ J, hermitian=True))


def planar_pose_covariance(hypothesis: Hypothesis, m: Floats, n: Floats, noise_rad: float) -> Floats:
    """The same for a pose whose points lie on a plane ``k . X = 1``.

    The unknowns are the five of the pose and the three of k. A match has two residuals then, those of the homography
    ``R + t k^T``, so that the pose is better known than from epipolar lines alone.

    Shapes: ``m, n`` (N, 3), returns (5, 5).

    * Returns: In rad^2, in the unknowns of :attr:`quest.RelativePose.covariance`.
    """
    R, t, inliers = hypothesis.R, hypothesis.t, hypothesis.inliers
    m, n = m[inliers], n[inliers]
    # n x (R m + t (k . m)) = 0 is linear in k.
    n_cross_t, n_cross_a = np.cross(n, t), np.cross(n, m @ R.T)
    k = np.linalg.lstsq((n_cross_t[:, :, None] * m[:, None, :]).reshape(-1, 3), -n_cross_a.reshape(-1), rcond=None)[0]
    rotated = m @ R.T
    y = rotated + np.outer(m @ k, t)
    # Derivatives of y = R m + t (k . m) by w, b and k: columns e_i x R m, (k . m) B_j and m_l t.
    dy = np.concatenate(
        [
            np.cross(np.eye(3)[None], rotated[:, None, :]).swapaxes(1, 2),
            (m @ k)[:, None, None] * tangent_basis(t)[None],
            t[None, :, None] * m[:, None, :],
        ],
        axis=2,
    )
    # The residual is the part of y / |y| that is tangent to n; on its line y is n up to the noise.
    basis = tangent_basis(n)
    J = np.einsum("nia,nix->nax", basis, dy) / (np.sqrt(2.0) * np.linalg.norm(y, axis=1))[:, None, None]
    r = np.einsum("nia,ni->na", basis, homography_residuals(R + np.outer(t, k), m, n))
    information = np.einsum("nax,nay->xy", J, J)
    covariance = _spread(r.reshape(-1), noise_rad, J.shape[2]) * np.linalg.pinv(information, hermitian=True)
    return np.asarray(covariance[:5, :5])


def _spread(r: Floats, noise_rad: float, unknowns: int) -> float:
    """Variance of a residual as an M-estimate of a number of unknowns has it."""
    u = (r / (GATE_SIGMAS * noise_rad)) ** 2
    means = float(np.mean((r / (1 + u) ** 2) ** 2)), float(np.mean((1 - 3 * u) / (1 + u) ** 3))
    return _spread_of_means(len(r), unknowns, *means)


def refine_rotation(R: Floats, m: Floats, n: Floats, scale_rad: float, iterations: int = 10) -> Floats:
    """Robust rotation ``n = R m``: iteratively re-weighted Kabsch with the weights of :func:`refine_pose`.

    Shapes: ``R`` (3, 3), ``m, n`` (N, 3), returns (3, 3).

    * ``scale_rad``: Scale of the Geman-McClure kernel for ``|n - R m| / sqrt(2)``, which has the noise of one bearing
      per component.
    * ``iterations``: Largest number of steps. The loop ends earlier where a step changes nothing.
    """
    for _ in range(iterations):
        r2 = 0.5 * np.sum((n - m @ R.T) ** 2, axis=1)
        weight = 1 / (1 + r2 / (scale_rad * scale_rad)) ** 2
        U, _, Vt = np.linalg.svd((n * weight[:, None]).T @ m)
        R_new = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
        change = np.abs(R_new - R).max()
        R = R_new
        if change < 1e-12:
            break
    return R


def _spread_of_means(count: int, unknowns: int, psi2: float, slope: float) -> float:
    """The same from the means of psi^2 and psi' over a number of residuals."""
    return count / max(count - unknowns, 1) * psi2 / max(slope, 0.1) ** 2


def _poses_of_plane(H: Floats, m: Floats, model: Floats) -> list[Floats]:
    """The motions (q_wxyz, t) of a homography of points m (N, 3), the one nearest to the given motion first."""
    motions = decompose_homography(H, m)
    poses = [np.r_[quaternion_from_matrix(R), t / np.linalg.norm(t)] for R, t, _ in motions if t.any()]
    return sorted(poses, key=lambda pose: -abs(float(pose[:4] @ model[:4])) - 0.25 * float(pose[4:] @ model[4:]))
