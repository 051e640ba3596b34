r"""A plane seen by several views: its model, the cost of each track, and the adjustment of the model.

With view 0 as the reference, view k sees a point of the plane ``k . X = 1`` at ``x_k = pi((R_k + t_k k^T) x)``, with x
the ray of the point in view 0. The unknowns are the plane k (two unknowns, since its length is the scale), the motions
``R_k, t_k``, and the true x of each track. All points stay on the plane.

The true x of each track is eliminated. Let e be the differences between the measured x_k and the x_k that the measured
x_0 predicts, and G their derivative by x. With noise of variance s^2 in all views, the cost of a track is

    c = (e^T e - e^T G (1 + G^T G)^-1 G^T e) / s^2

It has 2 K degrees of freedom, where K is the number of views besides the reference that see the track.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose

__all__ = ["PlaneModel", "PlaneViews", "adjust_plane", "linearize", "normal_equations", "plane_costs", "stepped"]

#: Number of damped Gauss-Newton steps; the starts are a few pixels off.
_STEPS = 20


@dataclass(frozen=True, eq=False)
class PlaneViews:
    """The tracks of a plane in the reference view and in K further views.

    Attributes
    ----------
    reference : (T, 2) float
        Normalized coordinates x/z, y/z in the reference view.
    others : (K, T, 2) float
        The same in the further views; NaN where a view does not see a track.
    noise : float
        Standard deviation of these coordinates.
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
        The plane ``k . X = 1`` in the frame of the reference view.
    cam_from_reference : tuple of K Pose
        One pose for each further view. The plane is at the distance 1 / norm(k) from the reference view.
    """

    k: Floats
    cam_from_reference: tuple[Pose, ...]


def plane_costs(views: PlaneViews, model: PlaneModel) -> Floats:
    """Compute the cost of each track.

    Parameters
    ----------
    views : PlaneViews
    model : PlaneModel

    Returns
    -------
    (T,) float
        Chi-square with 2 K degrees of freedom for a right model, with K the number of further views that see the track.
    """
    e, G, _ = linearize(views, model)
    return _marginal(e, G, views.noise)


def adjust_plane(views: PlaneViews, model: PlaneModel) -> PlaneModel:
    """Find the model of least cost near a start, by damped Gauss-Newton steps.

    A Geman-McClure kernel on the costs lowers the weight of tracks that are off the plane or outliers.

    Parameters
    ----------
    views : PlaneViews
    model : PlaneModel
        The start.

    Returns
    -------
    PlaneModel
    """
    cost, normal, gradient = normal_equations(views, model)
    damping = 1e-3
    for _ in range(_STEPS):
        # The scale is free: a step of k along itself does not change the cost, so the matrix alone is singular.
        scaled = normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.trace(normal) * np.eye(len(normal))
        step = -np.linalg.solve(scaled, gradient)
        moved = stepped(model, step)
        cost_new, normal_new, gradient_new = normal_equations(views, moved)
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


def stepped(model: PlaneModel, step: Floats) -> PlaneModel:
    """Apply a step to a model.

    Parameters
    ----------
    model : PlaneModel
    step : (3 + 6 K,) float
        Change of k, then for each view the rotation vector (applied from the left) and the change of the translation.

    Returns
    -------
    PlaneModel
    """
    poses = []
    for i, pose in enumerate(model.cam_from_reference):
        w, shift = np.split(step[3 + 6 * i : 9 + 6 * i], 2)
        poses.append(Pose(rotation_from_vector(w) @ pose.R, pose.t + shift))
    return PlaneModel(model.k + step[:3], tuple(poses))


def linearize(views: PlaneViews, model: PlaneModel) -> tuple[Floats, Floats, Floats]:
    """Compute the differences between measured and predicted coordinates, and their derivatives.

    Parameters
    ----------
    views : PlaneViews
    model : PlaneModel

    Returns
    -------
    e : (T, K, 2) float
        Measured minus predicted coordinates. All three results are zero where a view does not see a track.
    G : (T, K, 2, 2) float
        Derivatives of e by the coordinates of the track in the reference view.
    J : (T, K, 2, 9) float
        Derivatives of e by k, and by the rotation and the translation of the view.
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
    """Return the costs (T,) of the tracks, with the true ray of each track eliminated."""
    Gte = (np.swapaxes(G, 2, 3) @ e[..., None]).sum(axis=1)
    inner = np.eye(2) + (np.swapaxes(G, 2, 3) @ G).sum(axis=1)
    along = np.sum(Gte * np.linalg.solve(inner, Gte), axis=(1, 2))
    return np.asarray((np.sum(e * e, axis=(1, 2)) - along) / noise**2)


def normal_equations(views: PlaneViews, model: PlaneModel) -> tuple[float, Floats, Floats]:
    """Compute the robust cost and the normal equations of a Gauss-Newton step.

    With A = [J_k | J_0 ... J_K-1], where J_i is zero outside view i, the matrix of the equations is
    ``A^T (1 + G G^T)^-1 A = A^T A - B^T (1 + G^T G)^-1 B`` with ``B = G^T A``: the first term consists of blocks, the
    second term is one product of small rank.

    Parameters
    ----------
    views : PlaneViews
    model : PlaneModel

    Returns
    -------
    cost : float
        Sum of the costs under the robust kernel.
    normal : (3 + 6 K, 3 + 6 K) float
    gradient : (3 + 6 K,) float
        The undamped step is ``-solve(normal, gradient)``, in the order of :func:`stepped`.
    """
    e, G, J = linearize(views, model)
    costs = _marginal(e, G, views.noise)
    freedom = np.maximum(2 * np.isfinite(views.others[..., 0]).sum(axis=0), 1)
    # A track whose cost is three times its expectation has a quarter of the weight.
    share = 1 / (1 + costs / (3 * freedom))
    root = share / views.noise
    e, J = e * root[:, None, None], J * root[:, None, None, None]
    count, K = e.shape[:2]
    size = 3 + 6 * K
    # One matrix (2 T, 9) for each view.
    rows = np.moveaxis(J, 1, 0).reshape(K, 2 * count, 9)
    products = np.swapaxes(rows, 1, 2) @ rows
    right = (np.swapaxes(rows, 1, 2) @ np.moveaxis(e, 1, 0).reshape(K, 2 * count, 1))[..., 0]
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    normal[:3, :3], gradient[:3] = products[:, :3, :3].sum(axis=0), right[:, :3].sum(axis=0)
    GtJ = np.swapaxes(G, 2, 3) @ J
    B = np.zeros((count, 2, size))
    B[..., :3] = GtJ[..., :3].sum(axis=1)
    for i in range(K):
        of_view = slice(3 + 6 * i, 9 + 6 * i)
        normal[of_view, of_view] = products[i, 3:, 3:]
        normal[:3, of_view] = products[i, :3, 3:]
        normal[of_view, :3] = products[i, 3:, :3]
        gradient[of_view] = right[i, 3:]
        B[..., of_view] = GtJ[:, i, :, 3:]
    Gte = (np.swapaxes(G, 2, 3) @ e[..., None]).sum(axis=1)
    inner = np.eye(2) + (np.swapaxes(G, 2, 3) @ G).sum(axis=1)
    solved = np.linalg.solve(inner, np.concatenate([B, Gte], axis=2)).reshape(2 * count, size + 1)
    marginal = B.reshape(2 * count, size).T @ solved
    return float(np.sum(costs * share)), normal - marginal[:, :size], gradient - marginal[:, size]
