r"""Which of a plane's two explanations is right: the vote of all views, with the plane as a constraint.

Two views of a plane have two explanations (R, t, k), ``k . X = 1``, and both fit. From a third view on they predict
different things, since the true plane is the same from every pair and its twin's is not. Maps of free points hide that:
each point moves along its rays to where the wrong motion wants it. Here the points stay on the plane. With view 0 as
the reference, every view sees ``x_k = pi((R_k + t_k k^T) x)``, x the ray of a point in view 0; the unknowns are k (two:
its length is the scale), the motions, and the true x of each track.

The true x is eliminated: with e the differences of the measured x_k from what the measured x_0 predicts, and G their
derivative by x, noise of variance s^2 in all views gives the cost of a track

    c = (e^T e - e^T G (1 + G^T G)^-1 G^T e) / s^2

with 2 K degrees of freedom, K the views besides the reference that see it. Both explanations are adjusted from their
own start; the difference of their costs over all tracks, in units of its own fluctuation, is the vote (Vuong 1989). As
neither has points that give way, it grows with the square of what they predict differently.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from quest.estimate import Hypothesis, RelativePose
from quest.geometry.homography import decompose_homography, fit_homography, homography_residuals
from quest.geometry.quaternion import rotation_from_vector
from slam_init.mapping.rivals import explained_at_most, margin_of
from slam_init.mapping.views import TrackTable
from slam_init.types.arrays import Bools, Floats
from slam_init.types.comparison import Margin
from slam_init.types.pose import Pose

__all__ = ["PlaneModel", "PlaneViews", "adjust_plane", "plane_costs", "plane_margin", "plane_of_motion"]

Motion = Hypothesis | RelativePose

#: Damped Gauss-Newton steps; the starts are a few pixels off.
_STEPS = 20
#: Once in 740 cases by chance, if errors reach no further than a region of the view. Less than maps of free points are
#: asked for, where bad optima vote as well: of 1700 votes of planes, drawn and filmed, none was for the wrong one from
#: two deviations on.
_Z_NEEDED = 3.0
#: A view must see this many of the plane's points to have a say: six unknowns, and as many again to disagree.
_MIN_SEEN = 12


def plane_margin(table: TrackTable, first: Motion, second: Motion, noise_rad: float) -> Margin | None:
    """By how much one explanation of a plane is better than the other; negative where it is worse.

    Parameters
    ----------
    table : TrackTable
        The tracks of the pair, in the pair and in all views that shall vote.
    first, second : Hypothesis or RelativePose
        The two motions of the pair.
    noise_rad : float
        Standard deviation of a bearing.

    Returns
    -------
    Margin or None
        None where no third view sees the plane, or a ray is not before the camera.
    """
    rays = table.bearings
    if np.nanmin(rays[..., 2]) <= 0.1:  # beyond 84 degrees from the axis x/z is no coordinate any more
        return None
    on_plane = first.inliers | second.inliers
    homographies = _homographies(table, on_plane)
    rows = sorted(homographies)
    if len(rows) < 2 or rows[0] != 1:
        return None
    views = PlaneViews(rays[0, :, :2] / rays[0, :, 2:], rays[rows, :, :2] / rays[rows, :, 2:], noise_rad)
    costs = []
    for motion in (first, second):
        k = plane_of_motion(motion.R, motion.t, rays[0, motion.inliers], rays[1, motion.inliers])
        motions = [_motion_before(k, homographies[row], rays[0, on_plane]) for row in rows]
        if any(pose is None for pose in motions):  # a view that did not move from the first
            return None
        model = adjust_plane(views, PlaneModel(k, tuple(pose for pose in motions if pose is not None)))
        costs.append(plane_costs(views, model))
    freedom = 2 * np.isfinite(views.others[..., 0]).sum(axis=0)
    # What the residuals show, where they show more: most tracks are on the plane, and the median of chi-square is about
    # its mean.
    inflation = max(1.0, min(float(np.median(cost[freedom > 0] / freedom[freedom > 0])) for cost in costs))
    limit = explained_at_most(freedom)
    difference = np.minimum(costs[1] / inflation, limit) - np.minimum(costs[0] / inflation, limit)
    return replace(margin_of(difference, views.reference), z_needed=_Z_NEEDED)


def plane_of_motion(R: Floats, t: Floats, m: Floats, n: Floats) -> Floats:
    """The plane (3,) ``k . X = 1`` that explains most matches (N, 3) of a motion: ``n x (R m + t (k . m)) = 0``."""
    n_cross_t = np.cross(n, t)
    gain = np.linalg.norm(n_cross_t, axis=1)
    along = n_cross_t / np.maximum(gain, 1e-300)[:, None]
    offset = -np.einsum("ij,ij->i", along, np.cross(n, m @ R.T))
    A = m * gain[:, None]
    weight = np.ones(len(m))
    k = np.zeros(3)
    for _ in range(6):
        weighted = A * weight[:, None]
        k = np.linalg.lstsq(weighted.T @ A, weighted.T @ offset, rcond=None)[0]
        r = offset - A @ k
        scale = max(1.4826 * float(np.median(np.abs(r))), 1e-12)
        weight = 1 / (1 + (r / (3 * scale)) ** 2) ** 2
    return np.asarray(k)


def _homographies(table: TrackTable, on_plane: Bools) -> dict[int, Floats]:
    """Row of the table -> homography from the first row, of the tracks of the plane."""
    found = {}
    for row in range(1, len(table.frames)):
        visible = on_plane & np.isfinite(table.bearings[row, :, 0])
        if visible.sum() < _MIN_SEEN:
            continue
        m, n = table.bearings[0, visible], table.bearings[row, visible]
        weight = np.ones(len(m))
        for _ in range(4):
            H = fit_homography(m, n, weight)
            r2 = np.sum(homography_residuals(H, m, n) ** 2, axis=1)
            weight = 1 / (1 + r2 / max(9 * float(np.median(r2)), 1e-24)) ** 2
        found[row] = H
    return found


def _motion_before(k: Floats, H: Floats, m: Floats) -> Pose | None:
    """The motion whose plane is nearest to k, of the two that a homography has."""
    solutions = decompose_homography(H, m)
    if not solutions:
        return None
    R, t, own = max(solutions, key=lambda s: float(s[2] @ k) / float(np.linalg.norm(s[2])))
    return Pose(R, t * float(np.linalg.norm(own) / np.linalg.norm(k)))


@dataclass(frozen=True, eq=False)
class PlaneViews:
    """Tracks of a plane: in the reference view and in K further ones.

    Attributes
    ----------
    reference : (T, 2) float
        Normalized coordinates x/z, y/z in the reference view.
    others : (K, T, 2) float
        The same in the others; NaN where a view does not see a track.
    noise : float
        Their standard deviation.
    """

    reference: Floats
    others: Floats
    noise: float


@dataclass(frozen=True, eq=False)
class PlaneModel:
    """A plane and the motions of the views.

    Attributes
    ----------
    k : (3,) float
        The plane ``k . X = 1`` in the frame of the reference.
    cam_from_reference : tuple of K Pose
        In the unit of the plane's distance, which is 1 / norm(k).
    """

    k: Floats
    cam_from_reference: tuple[Pose, ...]


def plane_costs(views: PlaneViews, model: PlaneModel) -> Floats:
    """Cost (T,) of each track: chi-square of 2 K degrees of freedom for a right model, K the views that see it."""
    e, G, _ = _linearize(views, model)
    return _marginal(e, G, views.noise)


def adjust_plane(views: PlaneViews, model: PlaneModel) -> PlaneModel:
    """The model of least cost near a start, over the tracks that it explains.

    Tracks off the plane and wrong matches lose their weight by a Geman-McClure kernel on their costs.
    """
    cost, normal, gradient = _normal_equations(views, model)
    damping = 1e-3
    for _ in range(_STEPS):
        # The scale is free: a step along k is none.
        scaled = normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(len(normal))
        step = -np.linalg.solve(scaled, gradient)
        moved = _moved(model, step)
        cost_new, normal_new, gradient_new = _normal_equations(views, moved)
        if cost_new <= cost:
            settled = cost - cost_new <= 1e-6 * cost
            model, cost, normal, gradient = moved, cost_new, normal_new, gradient_new
            damping = max(0.1 * damping, 1e-9)
            if settled:
                break
        else:
            damping *= 10
            if damping > 1e4:
                break
    return model


def _moved(model: PlaneModel, step: Floats) -> PlaneModel:
    poses = []
    for i, pose in enumerate(model.cam_from_reference):
        w, shift = np.split(step[3 + 6 * i : 9 + 6 * i], 2)
        poses.append(Pose(rotation_from_vector(w) @ pose.R, pose.t + shift))
    return PlaneModel(model.k + step[:3], tuple(poses))


def _linearize(views: PlaneViews, model: PlaneModel) -> tuple[Floats, Floats, Floats]:
    """Differences e (T, K, 2), their derivatives G (T, K, 2, 2) by the ray, J (T, K, 2, 9) by k, rotation and shift.

    Where a view does not see a track, all three are zero.
    """
    R = np.array([pose.R for pose in model.cam_from_reference])
    t = np.array([pose.t for pose in model.cam_from_reference])
    x = np.column_stack([views.reference, np.ones(len(views.reference))])
    turned = np.einsum("kij,tj->tki", R, x)
    inverse_depth = x @ model.k
    X = turned + t * inverse_depth[:, None, None]
    seen = np.isfinite(views.others[..., 0]).T & (X[..., 2] > 1e-6)
    z = np.where(seen, X[..., 2], 1.0)
    projected = X[..., :2] / z[..., None]
    e = np.where(seen[..., None], np.swapaxes(views.others, 0, 1) - projected, 0.0)
    # d pi / dX, zero where nothing is seen.
    D = np.zeros((*z.shape, 2, 3))
    D[..., 0, 0] = D[..., 1, 1] = 1 / z
    D[..., :, 2] = -projected / z[..., None]
    D[~seen] = 0.0
    H = R + t[:, :, None] * model.k
    G = -D @ H[None, :, :, :2]
    J = np.zeros((*z.shape, 2, 9))
    J[..., :3] = -(D @ t[:, :, None]) * x[:, None, None, :]
    skew = np.zeros((*z.shape, 3, 3))
    skew[..., 0, 1], skew[..., 0, 2], skew[..., 1, 2] = turned[..., 2], -turned[..., 1], turned[..., 0]
    J[..., 3:6] = -D @ (skew - np.swapaxes(skew, -1, -2))
    J[..., 6:] = -D * inverse_depth[:, None, None, None]
    return e, G, J


def _marginal(e: Floats, G: Floats, noise: float) -> Floats:
    Gte = (np.swapaxes(G, 2, 3) @ e[..., None]).sum(axis=1)
    inner = np.eye(2) + (np.swapaxes(G, 2, 3) @ G).sum(axis=1)
    along = np.sum(Gte * np.linalg.solve(inner, Gte), axis=(1, 2))
    return np.asarray((np.sum(e * e, axis=(1, 2)) - along) / noise**2)


def _normal_equations(views: PlaneViews, model: PlaneModel) -> tuple[float, Floats, Floats]:
    """Robust cost, and the equations of a step: k, then rotation and shift of each view.

    With A = [J_k | J_0 ... J_K-1], where J_i is zero outside view i, the equations are those of
    ``A^T (1 + G G^T)^-1 A = A^T A - B^T (1 + G^T G)^-1 B`` with ``B = G^T A``: blocks, and one product of small rank.
    """
    e, G, J = _linearize(views, model)
    costs = _marginal(e, G, views.noise)
    freedom = np.maximum(2 * np.isfinite(views.others[..., 0]).sum(axis=0), 1)
    # A track at three times its expectation has a quarter of the weight.
    share = 1 / (1 + costs / (3 * freedom))
    root = share / views.noise
    e, J = e * root[:, None, None], J * root[:, None, None, None]
    count, K = e.shape[:2]
    size = 3 + 6 * K
    # A view at a time: (2 T, 9) each.
    rows = np.moveaxis(J, 1, 0).reshape(K, 2 * count, 9)
    products = np.swapaxes(rows, 1, 2) @ rows
    right = (np.swapaxes(rows, 1, 2) @ np.moveaxis(e, 1, 0).reshape(K, 2 * count, 1))[..., 0]
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    normal[:3, :3], gradient[:3] = products[:, :3, :3].sum(axis=0), right[:, :3].sum(axis=0)
    GtJ = np.swapaxes(G, 2, 3) @ J
    B = np.zeros((count, 2, size))
    B[..., :3] = GtJ[..., :3].sum(axis=1)
    for i in range(K):
        own = slice(3 + 6 * i, 9 + 6 * i)
        normal[own, own] = products[i, 3:, 3:]
        normal[:3, own] = products[i, :3, 3:]
        normal[own, :3] = products[i, 3:, :3]
        gradient[own] = right[i, 3:]
        B[..., own] = GtJ[:, i, :, 3:]
    Gte = (np.swapaxes(G, 2, 3) @ e[..., None]).sum(axis=1)
    inner = np.eye(2) + (np.swapaxes(G, 2, 3) @ G).sum(axis=1)
    solved = np.linalg.solve(inner, np.concatenate([B, Gte], axis=2)).reshape(2 * count, size + 1)
    marginal = B.reshape(2 * count, size).T @ solved
    return float(np.sum(costs * share)), normal - marginal[:, :size], gradient - marginal[:, size]
