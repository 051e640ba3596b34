"""The equations of a window in plain numpy: all derivatives of each observation in one row, one elimination a track."""

from dataclasses import dataclass

import numpy as np

from quest.algebra import tangents
from slam_init.lenses.point import project_point
from slam_init.window.arguments import FIELD_TERMS, ZOOM_TERMS
from slam_init.window.kernel import OFF_PLANE_COST
from slam_init.window.state import WindowState
from slam_init.window.tracks import WindowTracks


@dataclass(frozen=True, eq=False)
class Reference:
    """What :func:`slam_init.window.kernel.evaluate` gives, after the elimination; without any prior."""

    cost: float
    normal: np.ndarray
    gradient: np.ndarray
    shares: np.ndarray


def cross_matrix(v: np.ndarray) -> np.ndarray:
    """``[v]x``."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def reference_equations(
    tracks: WindowTracks, state: WindowState, gate: float, *, field: int, readout: bool, principal: bool
) -> Reference:
    """The equations at a state; all tracks off the plane have a free distance."""
    views, count = tracks.seen.shape
    fields, block = field, 6 + field
    focal = block * (views - 1) + fields
    lens = 2 + readout + 2 * principal
    size = focal + lens + (0 if state.plane is None else 3)
    normal, shares, total = np.zeros((size, size)), np.zeros((count, size)), 0.0
    camera = tracks.camera.numbers
    for i, a in enumerate(tracks.anchor):
        if a < 0:
            continue
        rows, residuals = [], []
        R_a, t_a, d = state.R[a], state.t[a], state.rays[i]
        # Derivatives of the inverse distance by the common unknowns and by the ray.
        rho, rho_common, rho_ray = state.inverse_distances[i], np.zeros(size), np.zeros(3)
        on_plane = bool(state.on_plane[i])
        if on_plane:
            u, c = R_a.T @ d, -R_a.T @ t_a
            below = 1 - state.plane @ c
            rho = state.plane @ u / below
            rho_ray = R_a @ state.plane / below
            rho_common[-3:] = u / below + rho / below * c
            if a > 0:
                first = fields + block * (a - 1)
                # u and c turn with the camera: d/dw of R^T d is R^T [d]x.
                rho_common[first : first + 3] = (state.plane @ R_a.T @ cross_matrix(d)) / below
                rho_common[first : first + 3] -= rho / below * (state.plane @ R_a.T @ cross_matrix(t_a))
                rho_common[first + 3 : first + 6] = -rho / below * (state.plane @ R_a.T)
        elif state.plane is not None:
            total += OFF_PLANE_COST
        bases = np.reshape(tangents(d), (2, 3)).T
        for k in np.flatnonzero(tracks.seen[:, i]):
            Q = state.R[k] @ R_a.T
            v = d - rho * t_a
            x = Q @ v
            scale = np.exp(state.lens.log_scale + (field == ZOOM_TERMS) * state.field[k, 0])
            seen, *numbers = project_point(camera, scale, state.lens.k1, *(x + rho * state.t[k]))
            if not seen or (on_plane and rho <= 0):
                total += gate**2
                continue
            pixel, D, by_k1 = np.array(numbers[:2]), np.reshape(numbers[2:8], (2, 3)), np.array(numbers[8:])
            J = np.zeros((2, size + 3))
            by_rho = D @ (state.t[k] - Q @ t_a) if k != a else np.zeros(2)
            J[:, size : size + 2] = (D @ Q + np.outer(by_rho, rho_ray)) @ bases
            J[:, size + 2] = 0.0 if on_plane else by_rho
            J[:, :size] = np.outer(by_rho, rho_common)
            if k != a and k > 0:
                first = fields + block * (k - 1)
                J[:, first : first + 6] += D @ np.hstack([-cross_matrix(x), rho * np.eye(3)])
            if k != a and a > 0:
                first = fields + block * (a - 1)
                J[:, first : first + 6] -= D @ Q @ np.hstack([-cross_matrix(v), rho * np.eye(3)])
            J[:, focal], J[:, focal + 1] = pixel - camera[3:5], by_k1
            if readout:
                J[:, focal + 2] = tracks.sweep_px_s[k, i]
            if principal:
                J[:, focal + lens - 2 : focal + lens] = np.eye(2)
            if field == ZOOM_TERMS:
                first = fields + block * (k - 1) + 6 if k else 0
                J[:, first : first + ZOOM_TERMS] = np.column_stack([pixel - camera[3:5], np.eye(2)])
                pixel = pixel + state.field[k, 1:ZOOM_TERMS]
            J /= tracks.sigma_px[k, i]
            e = pixel + (state.lens.readout_s - tracks.readout_s) * tracks.sweep_px_s[k, i] - tracks.pixels[k, i]
            e = (e + state.lens.principal_px) / tracks.sigma_px[k, i]
            if field == FIELD_TERMS:
                first = fields + block * (k - 1) + 6 if k else 0
                place = np.kron(np.eye(2), tracks.places[k, i])
                J[:, first : first + FIELD_TERMS] += place
                e = e + place @ state.field[k]
            J, e = tracks.whitening[k, i] @ J, tracks.whitening[k, i] @ e
            left = max(1 - e @ e / (3 * gate**2), 0.0)
            total += gate**2 * (1 - left**3)
            rows.append(left * J)
            residuals.append(left * e)
        J, e = np.vstack(rows), np.concatenate(residuals)
        own = J[:, size : size + (2 if on_plane else 3)]
        A = own.T @ own
        A += 1e-9 * (np.diag(np.diag(A)) + np.eye(len(A)))
        follow = np.linalg.solve(A, own.T)
        normal += J[:, :size].T @ (J[:, :size] - own @ (follow @ J[:, :size]))
        shares[i] = J[:, :size].T @ (e - own @ (follow @ e))
    return Reference(total, normal, shares.sum(axis=0), shares)
