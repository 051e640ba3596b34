"""The readable refinement of an absolute pose, which the compiled one has to equal."""

import numpy as np

from quest.geometry.quaternion import rotation_from_vector
from slam_init.types.arrays import Floats
from slam_init.types.pose import Pose


def refine_absolute_pose(pose: Pose, points: Floats, bearings: Floats, scale_rad: float, iterations: int = 8) -> Pose:
    """Refine a pose by Gauss-Newton steps on the angles between rays and points, with a Geman-McClure kernel."""

    def residuals(pose: Pose) -> tuple[Floats, Floats, Floats]:
        X = pose.apply(points)
        distance = np.maximum(np.linalg.norm(X, axis=1), 1e-12)
        ray = X / distance[:, None]
        r = ray - bearings
        # d ray / dX = (I - ray ray^T) / distance; dX = w x X + tau for a perturbation (w, tau) from the left.
        projector = (np.eye(3) - ray[:, :, None] * ray[:, None, :]) / distance[:, None, None]
        zero = np.zeros(len(X))
        cross = np.stack(
            [
                np.stack([zero, X[:, 2], -X[:, 1]], axis=1),
                np.stack([-X[:, 2], zero, X[:, 0]], axis=1),
                np.stack([X[:, 1], -X[:, 0], zero], axis=1),
            ],
            axis=1,
        )
        J = np.concatenate([projector @ cross, projector], axis=2)
        return r, J, np.sum(r * r, axis=1)

    r, J, r2 = residuals(pose)
    scale2 = scale_rad * scale_rad
    cost, damping = float(np.sum(r2 / (scale2 + r2))), 1e-4
    for _ in range(iterations):
        weight = 1 / (1 + r2 / scale2) ** 2
        A = np.einsum("nki,n,nkj->ij", J, weight, J)
        g = np.einsum("nki,n,nk->i", J, weight, r)
        A[np.diag_indices(6)] += damping * np.diag(A) + 1e-300
        try:
            step = -np.linalg.solve(A, g)
        except np.linalg.LinAlgError:  # the points do not determine the pose: keep the current one
            break
        R = rotation_from_vector(step[:3])
        moved = Pose(R @ pose.R, R @ pose.t + step[3:])
        r_new, J_new, r2_new = residuals(moved)
        cost_new = float(np.sum(r2_new / (scale2 + r2_new)))
        if cost_new <= cost:
            gain = cost - cost_new
            pose, r, J, r2, cost = moved, r_new, J_new, r2_new, cost_new
            damping = max(0.1 * damping, 1e-9)
            if gain <= 1e-9 * cost:
                break
        else:
            damping *= 10
    return pose
