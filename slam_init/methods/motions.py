"""The motions of an essential matrix or a homography, and the points that each motion puts in front of the cameras.

References
----------
.. [1] R. Hartley, A. Zisserman, "Multiple View Geometry", 2004, sections 9.6 (E to motions), 12.2 (triangulation).
.. [2] O. Faugeras, F. Lustman, "Motion and structure from motion in a piecewise planar environment", IJPRAI 1988.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_init.types.arrays import Bools, Floats
from slam_init.types.camera import Camera
from slam_init.types.pose import Pose


def motions_of_essential(E: Floats) -> tuple[Floats, Floats]:
    """Compute the four motions ``cam2_from_cam1`` of an essential matrix [1]_.

    Shapes: ``E`` (3, 3), returns ``R`` (4, 3, 3), returns ``t`` (4, 3).
    """
    U, _, Vt = np.linalg.svd(E)
    W = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    proper = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    R1, R2, t = proper * U @ W @ Vt, proper * U @ W.T @ Vt, U[:, 2]
    return np.array([R1, R2, R1, R2]), np.array([t, t, -t, -t])


def motions_of_homography(H: Floats, ratio_gate: float) -> tuple[Floats, Floats]:
    """Compute the eight motions ``cam2_from_cam1`` of a homography of rays [2]_.

    Shapes: ``H`` (3, 3), returns ``R`` (8, 3, 3), returns ``t`` (8, 3).

    * ``ratio_gate``: A number just above 1. There are no motions if the ratio of two neighbouring singular values is
      not larger: then there is no translation, or the plane is not unique.
    * Returns: Both arrays are empty if there are no motions.
    """
    U, d, Vt = np.linalg.svd(H)
    d1, d2, d3 = d
    if not (d1 > ratio_gate * d2 and d2 > ratio_gate * d3):
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    sign = np.linalg.det(U) * np.linalg.det(Vt)
    x1, x3 = np.sqrt((d1**2 - d2**2) / (d1**2 - d3**2)), np.sqrt((d2**2 - d3**2) / (d1**2 - d3**2))
    across = np.sqrt((d1**2 - d2**2) * (d2**2 - d3**2)) / d2
    rotations, translations = [], []
    for side in (1, -1):  # d' = d2 and d' = -d2
        cosine, sine = side * (d2**2 + d1 * side * d3) / ((d1 + side * d3) * d2), across / (d1 + side * d3)
        for e1, e3 in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            s = e1 * e3 * sine
            R = np.array([[cosine, 0, -side * s], [0, side, 0], [s, 0, side * cosine]])
            t = U @ np.array([e1 * x1, 0, -side * e3 * x3])
            rotations.append(sign * U @ R @ Vt)
            translations.append(t / np.linalg.norm(t))
    return np.array(rotations), np.array(translations)


@dataclass(frozen=True)
class CheckRule:
    """The rule that decides whether a triangulated match counts for a motion."""

    #: Largest reprojection error in each image.
    max_error_px: float
    #: Cosine of an angle. If the angle between the rays of a point is smaller, the point may be at infinity: it may
    #: lie behind a camera, and does not become a landmark.
    distant_cos: float
    #: The parallax of a motion is the largest angle of a point after this many larger ones.
    ranked: int = 50
    #: Triangulate by the midpoint of the common perpendicular instead of the linear method.
    midpoint: bool = False


#: Each inlier in front of both cameras counts: the estimator has tested the residuals, and no point is at infinity.
IN_FRONT = CheckRule(max_error_px=float("inf"), distant_cos=1.0)
#: The same, triangulated by midpoints.
IN_FRONT_BY_MIDPOINTS = CheckRule(max_error_px=float("inf"), distant_cos=1.0, midpoint=True)


@dataclass(frozen=True, eq=False)
class MotionCheck:
    """The triangulated matches of K motions."""

    #: (K, 3, 3) Rotations of the motions ``cam2_from_cam1``.
    R: Floats
    #: (K, 3) Translations of the motions, |t| = 1.
    t: Floats
    #: (K, N) Matches that count for the motion.
    good: Bools
    #: (K, N) Good matches that are near enough to become points.
    landmarks: Bools
    #: (K, N, 3) In the frame of camera 1, in units of the baseline; NaN for matches that were not used.
    points: Floats
    #: (K,) The ranked parallax of the good matches (:attr:`CheckRule.ranked`); zero without good matches.
    parallax_deg: Floats

    def pose(self, k: int) -> Pose:
        """Return one motion."""
        return Pose(self.R[k], self.t[k])

    def best(self) -> tuple[int, int, float]:
        """Find the motion with most good matches: its position, their number, and their ranked parallax."""
        good = self.good.sum(axis=1)
        k = int(np.argmax(good))
        return k, int(good[k]), float(self.parallax_deg[k])

    def second_share(self) -> float:
        """Compute the number of good matches of the second best motion over that of the best one."""
        good = self.good.sum(axis=1)
        k = int(np.argmax(good))
        return float(np.delete(good, k).max() / max(good[k], 1))


def check_motions(
    camera: Camera, R: Floats, t: Floats, bearings1: Floats, bearings2: Floats, inliers: Bools, rule: CheckRule
) -> MotionCheck:
    """Triangulate the inliers with each motion, and find those in front of both cameras with small reprojection errors.

    Shapes: ``R`` (K, 3, 3), ``t`` (K, 3), ``bearings1, bearings2`` (N, 3), ``inliers`` (N,).
    """
    used = np.flatnonzero(inliers)
    x1, x2 = (rays[used] / rays[used, 2:] for rays in (bearings1, bearings2))
    focal = np.diagonal(camera.K)[:2]
    with np.errstate(all="ignore"):  # parallel rays meet at infinity: their point is not finite, and not good
        in1 = _midpoints(R, t, bearings1[used], bearings2[used]) if rule.midpoint else _linear(R, t, x1, x2)
        in2 = in1 @ R.swapaxes(-1, -2) + t[:, None, :]
        # Cosine of the angle between the rays to a point; R X is the ray from camera 1, R X + t the ray from camera 2.
        cosine = np.sum((in1 @ R.swapaxes(-1, -2)) * in2, axis=-1)
        cosine /= np.linalg.norm(in1, axis=-1) * np.linalg.norm(in2, axis=-1)
        error1 = np.sum(((in1[..., :2] / in1[..., 2:] - x1[:, :2]) * focal) ** 2, axis=-1)
        error2 = np.sum(((in2[..., :2] / in2[..., 2:] - x2[:, :2]) * focal) ** 2, axis=-1)
        before = (in1[..., 2] > 0) & (in2[..., 2] > 0)
        near = cosine < rule.distant_cos
        good = np.isfinite(in1).all(axis=-1) & (before | ~near)
        good &= (error1 <= rule.max_error_px**2) & (error2 <= rule.max_error_px**2)
    count = len(inliers)
    all_good, landmarks = np.zeros((len(R), count), bool), np.zeros((len(R), count), bool)
    points = np.full((len(R), count, 3), np.nan)
    all_good[:, used], landmarks[:, used], points[:, used] = good, good & near, in1
    return MotionCheck(R, t, all_good, landmarks, points, _ranked_parallax_deg(cosine, good, rule.ranked))


def _ranked_parallax_deg(cosine: Floats, good: Bools, rank: int) -> Floats:
    """Return for each motion the angle of a good point after ``rank`` larger ones, or the smallest of fewer angles."""
    counts = good.sum(axis=1)
    if cosine.shape[1] == 0:
        return np.zeros(len(cosine))
    ordered = np.sort(np.where(good, cosine, np.inf), axis=1)
    at = np.clip(np.minimum(rank, counts - 1), 0, None)
    ranked = ordered[np.arange(len(cosine)), at]
    return np.where(counts > 0, np.degrees(np.arccos(np.clip(ranked, -1, 1))), 0.0)


def _linear(R: Floats, t: Floats, x1: Floats, x2: Floats) -> Floats:
    """Triangulate linearly [1]_: points (K, N, 3) from rays (N, 3) with z = 1."""
    K, N = len(R), len(x1)
    P = np.concatenate([R, t[..., None]], axis=-1)[:, None]  # (K, 1, 3, 4)
    identity = np.eye(3, 4)
    rows = np.empty((K, N, 4, 4))
    rows[..., 0, :] = x1[:, :1] * identity[2] - identity[0]
    rows[..., 1, :] = x1[:, 1:2] * identity[2] - identity[1]
    rows[..., 2, :] = x2[:, :1] * P[..., 2, :] - P[..., 0, :]
    rows[..., 3, :] = x2[:, 1:2] * P[..., 2, :] - P[..., 1, :]
    X = np.linalg.eigh(rows.swapaxes(-1, -2) @ rows)[1][..., 0]
    return np.asarray(X[..., :3] / X[..., 3:])


def _midpoints(R: Floats, t: Floats, m: Floats, n: Floats) -> Floats:
    """Return the midpoints (K, N, 3) of the common perpendiculars of the rays, in the frame of camera 1."""
    n1 = n @ R  # rows R^T n: the second ray in the frame of camera 1
    centre2 = -np.einsum("kji,kj->ki", R, t)
    c = np.sum(m * n1, axis=-1)
    along1, along2 = centre2 @ m.T, np.einsum("kni,ki->kn", n1, centre2)
    u = (along1 - c * along2) / (1 - c * c)
    v = (c * along1 - along2) / (1 - c * c)
    return np.asarray(0.5 * (u[..., None] * m + v[..., None] * n1 + centre2[:, None, :]))
