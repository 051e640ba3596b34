"""Two views of a few points, by name of the motion, and how far candidates are from the truth."""

import numpy as np

from quest.geometry.quaternion import matrix_from_quaternion


def unit(values) -> np.ndarray:
    a = np.asarray(values, float)
    return a / np.linalg.norm(a, axis=-1, keepdims=True)


def scene_points(seed: int, count: int, *, coplanar: bool = False) -> np.ndarray:
    """Points in front of camera 1, in a box or on a slanted plane."""
    X = np.random.default_rng(seed).uniform([-1.2, -0.9, 3], [1.2, 0.9, 6], (count, 3))
    if coplanar:
        X[:, 2] = 4.5 + 0.3 * X[:, 0] - 0.6 * X[:, 1]
    return X


def two_views(X: np.ndarray, q, t) -> tuple[np.ndarray, np.ndarray]:
    return unit(X), unit(X @ matrix_from_quaternion(q).T + t)


def distance(candidates: np.ndarray, q) -> float:
    """Chord of the closest candidate: half of the angle between the rotations, in radians."""
    q = np.asarray(q, float)
    both = np.minimum(np.linalg.norm(candidates - q, axis=1), np.linalg.norm(candidates + q, axis=1))
    return float(both.min(initial=2.0))


SCENES = {
    "general": ([0.9, 0.1, -0.2, 0.3], [0.7, -0.2, 0.4]),
    "identity": ([1, 0, 0, 0], [0.7, -0.2, 0.4]),
    "nearly the identity": ([1, 1e-5, -2e-5, 1e-5], [0.7, -0.2, 0.4]),
    "forward": ([1, 0, 0, 0], [0, 0, 0.8]),
    "sideways": ([1, 0, 0, 0], [0.8, 0, 0]),
    "half turn about x": ([0, 1, 0, 0], [0.7, -0.2, 0.4]),
    "half turn about y": ([0, 0, 1, 0], [0.7, -0.2, 0.4]),
    "half turn about z": ([0, 0, 0, 1], [0.7, -0.2, 0.4]),
    "half turn about a slanted axis": ([0, 0.6, -0.48, 0.64], [0.7, -0.2, 0.4]),
}
