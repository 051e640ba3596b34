"""The problems of the synthetic experiment of [F17], and its metric."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from quest.geometry.quaternion import matrix_from_quaternion

Floats = NDArray[np.float64]

_FOCAL_PX, _HALF_WIDTH_PX, _HALF_HEIGHT_PX = 800.0, 320.0, 240.0


@dataclass(frozen=True, eq=False)
class Problems:
    """Matched bearings (B, N, 3) and true rotations (B, 4) wxyz and translations (B, 3) of B problems."""

    m: Floats
    n: Floats
    q: Floats
    t: Floats


def draw_problems(
    rng: np.random.Generator,
    count: int,
    points: int,
    noise_px: float,
    *,
    coplanar: bool = False,
    witnesses: int = 0,
) -> Problems:
    """Draw problems of the protocol; a problem with a point outside of an image is sampled again.

    ``witnesses`` is the number of further points of the same scene, each sampled until it is in both images. They
    follow the points of the sample.
    """
    problems = [_draw_problem(rng, points, noise_px, coplanar, witnesses) for _ in range(count)]
    m, n, q, t = (np.array(values) for values in zip(*problems, strict=True))
    return Problems(m, n, q, t)


def _draw_problem(
    rng: np.random.Generator, points: int, noise_px: float, coplanar: bool, witnesses: int
) -> tuple[Floats, Floats, Floats, Floats]:
    while True:
        draw = _plane(rng) if coplanar else _box(rng)
        X = draw(points)
        t = rng.uniform(-1, 1, 3)
        axis, angle = _direction(rng), rng.uniform(0, np.radians(30))
        q = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
        R = matrix_from_quaternion(q)
        if np.linalg.norm(t) >= 0.2 and (_inside(X) & _inside(X @ R.T + t)).all():
            break
    while len(X) < points + witnesses:
        more = draw(100)
        seen = _inside(more) & _inside(more @ R.T + t)
        X = np.concatenate([X, more[seen]])[: points + witnesses]
    m, n = (_pixels(view) + noise_px * rng.normal(size=(len(X), 2)) for view in (X, X @ R.T + t))
    return _bearings(m), _bearings(n), q, t


def _box(rng: np.random.Generator) -> Callable[[int], Floats]:
    """A function that draws a given number of points in the box."""
    return lambda points: rng.uniform([-1.2, -0.9, 3], [1.2, 0.9, 6], (points, 3))


def _plane(rng: np.random.Generator) -> Callable[[int], Floats]:
    """A function that draws points within +-1 on a plane through (0, 0, 4.5), tilted by up to 60 degrees."""
    normal = _direction(rng)
    while abs(normal[2]) < 0.5:
        normal = _direction(rng)

    def draw(points: int) -> Floats:
        xy = rng.uniform(-1, 1, (points, 2))
        return np.column_stack([xy, 4.5 - xy @ normal[:2] / normal[2]])

    return draw


def _direction(rng: np.random.Generator) -> Floats:
    d = rng.normal(size=3)
    return np.asarray(d / np.linalg.norm(d))


def _pixels(X: Floats) -> Floats:
    return np.asarray(_FOCAL_PX * X[:, :2] / X[:, 2:])


def _inside(X: Floats) -> NDArray[np.bool_]:
    """Whether each point (N,) is in front of the camera and inside of the image."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inside = np.abs(_pixels(X)) <= (_HALF_WIDTH_PX, _HALF_HEIGHT_PX)
    return (X[:, 2] > 0) & inside.all(axis=1)


def _bearings(pixels: Floats) -> Floats:
    rays = np.column_stack([pixels / _FOCAL_PX, np.ones(len(pixels))])
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))


def rotation_error(candidates: Floats, q: Floats) -> Floats:
    """Metric of [F17] (B,) of the candidate (B, K, 4) nearest to the truth (B, 4); 1/2 without candidates."""
    cosine = np.abs((candidates @ q[..., None])[..., 0])
    # The arc cosine of a number near one has half of the digits only; the chord has all.
    sine = 0.5 * np.minimum(
        np.linalg.norm(candidates - q[:, None], axis=-1), np.linalg.norm(candidates + q[:, None], axis=-1)
    )
    error = np.where(np.isfinite(cosine), 2 * np.arcsin(np.minimum(sine, 1.0)) / np.pi, 0.5)
    return np.asarray(error.min(axis=1, initial=0.5))
