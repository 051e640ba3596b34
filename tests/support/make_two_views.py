"""Two noisy views of a scene with outliers, and the errors of an estimated pose."""

import numpy as np
from make_views import unit

from quest.geometry.quaternion import rotation_angle, rotation_from_vector

#: Noise of a bearing: 0.3 px at a focal length of 600 px.
NOISE_RAD = 5e-4
R_TRUE = rotation_from_vector([0.05, -0.15, 0.08])
T_TRUE = np.array([0.6, -0.1, 0.2])
NO_TRANSLATION = np.zeros(3)


def box(seed: int, count: int = 200) -> np.ndarray:
    """Points in a box of depths 3 to 6."""
    return np.random.default_rng(seed).uniform([-1.6, -1.2, 3], [1.6, 1.2, 6], (count, 3))


def plane(seed: int, count: int = 200) -> np.ndarray:
    """Points on a tilted plane."""
    X = box(seed, count)
    X[:, 2] = 4.5 + 0.3 * X[:, 0] - 0.6 * X[:, 1]
    return X


def wall(seed: int, count: int = 200) -> np.ndarray:
    """Points on a plane at right angles to the optical axis of camera 1."""
    return box(seed, count) * [2, 2, 0] + [0, 0, 4.5]


def line(seed: int, count: int = 200) -> np.ndarray:
    """Points on a line."""
    along = np.random.default_rng(seed).uniform(0, 1, (count, 1))
    return np.array([-0.8, 0.2, 4.0]) + along * np.array([1.6, 0.3, 1.0])


def all_around(seed: int, count: int = 200) -> np.ndarray:
    """Points in all directions from camera 1."""
    rng = np.random.default_rng(seed)
    return unit(rng.normal(size=(count, 3))) * rng.uniform(3, 7, (count, 1))


def random_rays(rng: np.random.Generator, count: int) -> np.ndarray:
    """Unit rays of a random image."""
    return unit(rng.uniform([-0.5, -0.4, 1], [0.5, 0.4, 1], (count, 3)))


def views(X, R=R_TRUE, t=T_TRUE, *, noise_rad: float = 0.0, outliers: float = 0.0, seed: int = 0):
    """Bearings of the points in both views; the first matches are the outliers."""
    rng = np.random.default_rng([seed, 1])
    m, n = (unit(rays + noise_rad * rng.normal(size=rays.shape)) for rays in (unit(X), unit(X @ R.T + t)))
    wrong = int(outliers * len(X))
    n[:wrong] = random_rays(rng, wrong)
    return m, n


def errors_deg(pose, R=R_TRUE, t=T_TRUE) -> tuple[float, float]:
    """Errors of the rotation and of the direction, degrees."""
    direction = np.linalg.norm(pose.t - unit(t))  # the chord, since the arc cosine is inaccurate for small angles
    return float(np.degrees(rotation_angle(pose.R @ R.T))), float(np.degrees(2 * np.arcsin(min(1.0, direction / 2))))


def is_true(pose, R=R_TRUE, t=T_TRUE, *, rotation_deg: float, direction_deg: float) -> bool:
    """Whether both errors of the pose are below the bounds."""
    rotation, direction = errors_deg(pose, R, t)
    return rotation < rotation_deg and direction < direction_deg
